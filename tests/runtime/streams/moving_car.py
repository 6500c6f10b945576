"""A camera, a LiDAR and poses on a car that drives to a wall."""

import numpy as np
import pytest

from car_poses import pose
from runtime.geometry.calibration import Calibration

MS = 1_000_000
INTRINSICS = np.array([[30.0, 0, 20], [0, 30, 16], [0, 0, 1]])
# The LiDAR looks ahead along x, its camera sits at the same place.
TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
CALIBRATION = Calibration(INTRINSICS, TO_CAMERA, (32, 40))
WALL_M, POINTS = 40.0, 135
DEGRADED = {"depth_reused", "depth_uncompensated", "no_pose", "pose_gap", "pose_jump", "pose_clock"}


def wall_scan(time_ms):
    """A wall that stands across the road, as the LiDAR measures it at a time: float32 (N, 3)."""
    side, up = (axis.ravel() for axis in np.meshgrid(np.linspace(-9, 9, 15), np.linspace(-7, 7, 9)))
    distance = WALL_M - 15.0 * time_ms / 1e3
    return np.stack([np.full(POINTS, distance), side, up], axis=1).astype(np.float32)


def car(time_ms):
    return pose((15.0 * time_ms / 1e3, 0, 0))


def measured(result):
    """The depth of the returns that the predictor was given (it answers one more)."""
    found = result.prediction.depth[result.prediction.depth > 1] - 1
    return float(np.median(found)) if len(found) else None


def expected(time_ms):
    return pytest.approx(WALL_M - 0.015 * time_ms, abs=2e-3)


def messages(*, until, scan_ms=100, lost=()):
    """(sensor, time) of a camera, a LiDAR and poses, in the order of time."""
    sensors = (("pose", 10), ("depth", scan_ms), ("image", 50))
    return sorted(
        (time_ms, order, sensor)
        for order, (sensor, period) in enumerate(sensors)
        for time_ms in range(0, until, period)
        if (sensor, time_ms) not in lost
    )
