"""A recorded KITTI stream: images, returns, a calibration and labels."""

import numpy as np

from layouts.pictures import write

# In the middles of pixels (4, 1) and (12, 1), a line at 10 m; then one at 5 m, in (4, 6) and,
# nearer, in (12, 1) again.
POINTS = [(10, 4, 3, 0), (10, -4, 3, 0), (5, 2, -1, 0), (5, -2, 1.5, 0)]


def write_calibration(root, magnify=1):
    """A camera of 10 px focal length, its centre at (8, 4), that looks along the LiDAR's x."""
    focal, u, v = 10 * magnify, 8 * magnify, 4 * magnify
    (root / "calib_cam_to_cam.txt").write_text(
        f"S_rect_02: {2 * u} {2 * v}\n"
        "R_rect_00: 1 0 0 0 1 0 0 0 1\n"
        f"P_rect_02: {focal} 0 {u} 0 0 {focal} {v} 0 0 0 1 0\n"
    )
    (root / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n")


def write_stream(root, *, frames=3, labelled=1, suffix=".png", magnify=1):
    """Frames with a line at 10 m and one at 5 m; the first ones have labels, a column each."""
    (root / "velodyne_fov").mkdir(parents=True)
    write_calibration(root, magnify)
    labels = np.broadcast_to(np.arange(16, dtype=np.uint8), (8, 16)).copy()
    labels[0] = 255
    for number in range(frames):
        image = np.full((8, 16, 3), 90, np.uint8)
        write(root / "image_02" / f"{number:010d}{suffix}", image, magnify)
        scan = root / "velodyne_fov" / f"{number:010d}.bin"
        scan.write_bytes(np.array(POINTS, "<f4").tobytes())
        if number < labelled:
            write(root / "pseudo_semantic" / f"{number:010d}.png", labels, magnify)


def write_objects(root):
    """The layout of KITTI's object data: frame 4 with a scan, frame 8 with a longer lens."""
    (root / "velodyne_fov").mkdir(parents=True)
    (root / "velodyne_fov" / "000004.bin").write_bytes(np.array(POINTS, "<f4").tobytes())
    (root / "calib").mkdir()
    for number, focal in ((4, 10), (8, 20)):
        write(root / "image_2" / f"{number:06d}.jpg", np.full((8, 16, 3), 90, np.uint8))
        write(root / "pseudo_semantic" / f"{number:06d}.png", np.full((8, 16), 14, np.uint8))
        (root / "calib" / f"{number:06d}.txt").write_text(
            f"P2: {focal} 0 8 0 0 {focal} 4 0 0 0 1 0\n"
            "R0_rect: 1 0 0 0 1 0 0 0 1\n"
            "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
        )
