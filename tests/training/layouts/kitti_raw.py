"""KITTI raw data: a drive with two cameras and its scans."""

import numpy as np

from layouts.pictures import write

DATE = "2011_09_26"
DRIVE = f"{DATE}_drive_0001_sync"
HEIGHT, WIDTH = 24, 48
# A focal length of 10 px, the principal point at (24, 12), camera 3 two metres to the right.
CAM_TO_CAM = """\
calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
R_rect_00: 1 0 0 0 1 0 0 0 1
S_rect_02: 4.800000e+01 2.400000e+01
P_rect_02: 10 0 24 0 0 10 12 0 0 0 1 0
S_rect_03: 4.800000e+01 2.400000e+01
P_rect_03: 10 0 24 -20 0 10 12 0 0 0 1 0
"""
# The camera sits half a metre before the LiDAR and looks along its x.
VELO_TO_CAM = """\
calib_time: 15-Mar-2012 11:37:16
R: 0 -1 0 0 0 -1 1 0 0
T: 0 0 -0.5
delta_f: 0 0
"""


def seen_at(u, v, depth):
    """The return that falls into the middle of pixel (u, v) of camera 2 at a depth."""
    return depth + 0.5, (24 - u) * depth / 10, (12 - v) * depth / 10, 0.3


# Two lines, each from straight ahead to the left and round to the right. Left is a small azimuth.
UPPER = [seen_at(20, 5, 10.0), seen_at(10, 5, 12.0), seen_at(40, 5, 8.0), seen_at(30, 5, 20.0)]
LOWER = [seen_at(20, 9, 6.0), seen_at(10, 5, 11.0), seen_at(40, 5, 9.0)]


def write_frame(root, points=(*UPPER, *LOWER), drive=DRIVE, number=0):
    """A frame of both cameras, whose pictures differ in blue."""
    folder = root / DATE / drive
    for camera in (2, 3):
        image = np.full((HEIGHT, WIDTH, 3), (200, 20, 40 + camera), np.uint8)
        write(folder / f"image_{camera:02d}" / "data" / f"{number:010d}.png", image)
    scan = folder / "velodyne_points" / "data" / f"{number:010d}.bin"
    scan.parent.mkdir(parents=True, exist_ok=True)
    scan.write_bytes(np.array(points, "<f4").tobytes())
    (root / DATE / "calib_cam_to_cam.txt").write_text(CAM_TO_CAM)
    (root / DATE / "calib_velo_to_cam.txt").write_text(VELO_TO_CAM)
