"""A camera of 48 x 64 pixels, a LiDAR beside it, and a scan projected a return after the other."""

import cv2
import numpy as np
import pytest

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
SIZE = (48, 64)
INTRINSICS = [[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]
# A camera looks along z with x to the right; its body along x with y to the left (REP 103).
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
# Of a car that drives, in metres a second.
SPEED = 15.0


class BackwardsOdometry:
    """Stands in for `Odometry`: the car drives backwards, and scans come at 10 Hz."""

    added = 0

    def add(self, points):
        pose = np.eye(4)
        pose[0, 3] = -0.1 * SPEED * self.added
        self.added += 1
        return pose


def add_tree(bag):
    """The LiDAR 0.3 m above the base, the camera 0.5 m ahead of it, turned to its optical axes."""
    bag.static_transform("base", "lidar", (0, 0, 0, 1), (0, 0, 0.3))
    bag.static_transform("base", "camera_body", (0, 0, 0, 1), (0.5, 0, 0))
    bag.static_transform("camera_body", "camera", OPTICAL, (0, 0, 0))


def write_video(path, codec, colours):
    """A video of frames of 48 x 64 pixels of one colour (BGR) each, at 20 Hz."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 20, SIZE[::-1])
    if not writer.isOpened():
        pytest.skip(f"this OpenCV writes no {codec}")
    for colour in colours:
        writer.write(np.full((*SIZE, 3), colour, np.uint8))
    writer.release()
    return path


def projected(scan, *, left_m=0.0, ahead_m=0.0, focal_px=60.0):
    """A camera 0.3 m below the LiDAR, so far to the left and ahead of it; the nearest wins."""
    depth = np.full(SIZE, np.inf)
    for x, y, z, *_ in scan.astype(np.float64):
        right, down, ahead = left_m - y, -(z + 0.3), x - ahead_m
        if ahead <= 0:
            continue
        column, row = round(focal_px * right / ahead + 32), round(focal_px * down / ahead + 24)
        if 0 <= row < SIZE[0] and 0 <= column < SIZE[1]:
            depth[row, column] = min(depth[row, column], ahead)
    return np.where(np.isinf(depth), 0, depth)


def agree(depth, expected):
    """Return whether two maps agree, except for returns that float32 rounds to another pixel."""
    same = (depth > 0) == (expected > 0)
    both = (depth > 0) & (expected > 0)
    return same.mean() > 0.995 and np.median(abs(depth - expected)[both]) < 1e-3
