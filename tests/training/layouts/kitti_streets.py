"""Streets of KITTI stereo 2015 with their scans: images, returns, disparities and a calibration."""

import numpy as np

from layouts.pictures import write

HEIGHT, WIDTH = 8, 16
# A camera of 10 px focal length, its centre at (8, 4), that looks along the LiDAR's x.
CALIBRATION = """\
P2: 10 0 8 0 0 10 4 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0
fb_disp: 40
"""


def seen_at(u, v, depth):
    """The return that falls into the middle of pixel (u, v) at a depth."""
    return depth, (8 - u) * depth / 10, (4 - v) * depth / 10, 0.3


# Four lines, each from the left to the right of the view.
LINES = [[seen_at(6, v, 10.0), seen_at(2, v, 10.0), seen_at(12, v, 10.0)] for v in (1, 3, 5, 7)]


def write_streets(root, numbers=(2, 3, 7), *, suffix=".jpg", magnify=1, road=False):
    """Frames with four lines at 10 m, and a truth of 10 m in the left half, unknown in the right.

    The picture of the first one is red, as JPEG or as PNG. With `road` the right half is masked
    as road.
    """
    disparity = np.zeros((HEIGHT, WIDTH), np.uint16)
    disparity[:, : WIDTH // 2] = 4 * 256
    points = np.array([point for line in LINES for point in line], "<f4")
    for folder in ("image_02", "velodyne_fov", "disp_occ_0"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    focal, cx, cy = 10 * magnify, 8 * magnify, 4 * magnify
    camera = f"P2: {focal} 0 {cx} 0 0 {focal} {cy} 0 0 0 1 0"
    (root / "calib.txt").write_text("\n".join([camera, *CALIBRATION.splitlines()[1:], ""]))
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, WIDTH // 2 :] = 1
    if road:
        (root / "road_mask").mkdir(exist_ok=True)
    for number in numbers:
        if road:
            write(root / "road_mask" / f"{number:06d}.png", mask, magnify)
        image = np.full((HEIGHT, WIDTH, 3), (200, 20, 40), np.uint8)
        write(root / "image_02" / f"{number:06d}{suffix}", image, magnify)
        write(root / "disp_occ_0" / f"{number:06d}.png", disparity, magnify)
        (root / "velodyne_fov" / f"{number:06d}.bin").write_bytes(points.tobytes())
