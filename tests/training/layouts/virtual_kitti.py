"""Both editions of Virtual KITTI; rendered scenes have the layout of the second."""

from pathlib import Path

import numpy as np

from layouts.pictures import write

# colors.txt of the second edition: name and RGB.
COLORS = {
    "Terrain": (210, 0, 200), "Sky": (90, 200, 255), "Tree": (0, 199, 0),
    "Vegetation": (90, 240, 0), "Building": (140, 140, 140), "Road": (100, 60, 100),
    "GuardRail": (250, 100, 255), "TrafficSign": (255, 255, 0), "TrafficLight": (200, 200, 0),
    "Pole": (255, 130, 0), "Misc": (80, 80, 80), "Truck": (160, 60, 60), "Car": (255, 127, 80),
    "Van": (0, 139, 139), "Undefined": (0, 0, 0),
}  # fmt: skip
HEIGHT, WIDTH = 8, 15
RED = (200, 20, 40)


def colour_rows(colors):
    rows = [f"{name} {r} {g} {b}" for name, (r, g, b) in colors.items()]
    return "\n".join(["Category r g b", *rows]) + "\n"


def label_picture(colors):
    """A column a category."""
    return np.broadcast_to(np.array(list(colors), np.uint8), (HEIGHT, len(colors), 3))


def depth_picture(number):
    """Sky in the first row, the farthest depth in the second, 12.34 m and more below."""
    depth = np.full((HEIGHT, WIDTH), 1234 + number, np.uint16)
    depth[0], depth[1] = 65535, 65534
    return depth


def write_second_edition(
    root, scene="Scene01", variant="clone", *, frames=2, cameras=(0,), magnify=1
):
    folder = root / scene / variant
    intrinsics = ["frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]"]
    for number in range(frames):
        for camera in (0, 1):
            intrinsics.append(f"{number} {camera} {725 + number} {726 + number} 620.5 18{camera}")
        for camera in cameras:
            for kind, name, image in (
                ("rgb", f"rgb_{number:05d}.jpg", np.full((HEIGHT, WIDTH, 3), RED, np.uint8)),
                ("depth", f"depth_{number:05d}.png", depth_picture(number)),
                ("classSegmentation", f"classgt_{number:05d}.png", label_picture(COLORS.values())),
            ):
                write(folder / "frames" / kind / f"Camera_{camera}" / name, image, magnify)
    (folder / "colors.txt").write_text(colour_rows(COLORS))
    (folder / "intrinsic.txt").write_text("\n".join(intrinsics) + "\n")
    return folder


def write_scans(variant, *, frames=2):
    """Write scans of four returns beside a variant of the second edition."""
    folder = variant / "frames" / "lidar" / "Camera_0"
    folder.mkdir(parents=True)
    points = np.array([(10, y, z, 0.5) for z in (0.5, -0.5) for y in (1, -1)], "<f4")
    for number in range(frames):
        (folder / f"lidar_{number:05d}.bin").write_bytes(points.tobytes())
    (variant / "calib.txt").write_text("Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")


def write_first_edition(root, scene="0001", variant="clone", *, numbers=(0, 1), magnify=1):
    # Every car and van is an instance with a colour of its own; nothing is undefined.
    colors = {name: rgb for name, rgb in COLORS.items() if name not in ("Car", "Van", "Undefined")}
    colors |= {"Car:Car0": (7, 8, 9), "Car:Car1": (10, 11, 12), "Van:Van3": (13, 14, 15)}
    labels = root / "vkitti_1.3.1_scenegt"
    for number in numbers:
        file = Path(scene) / variant / f"{number:05d}.png"
        image = np.full((HEIGHT, WIDTH, 3), RED, np.uint8)
        write(root / "vkitti_1.3.1_rgb" / file, image, magnify)
        write(root / "vkitti_1.3.1_depthgt" / file, depth_picture(number), magnify)
        write(labels / file, label_picture(colors.values()), magnify)
    encoding = labels / f"{scene}_{variant}_scenegt_rgb_encoding.txt"
    encoding.write_text(colour_rows(colors))
