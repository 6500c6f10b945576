"""A camera that drives to a wall along a road, and the depth maps of its LiDAR."""

import numpy as np

from runtime.geometry.calibration import Calibration

SIZE, FOCAL, CENTRE_ROW, HEIGHT_M, WALL_M = (120, 200), 100.0, 40.0, 1.6, 30.0
CALIBRATION = Calibration(
    np.array([[FOCAL, 0, 100.0], [0, FOCAL, CENTRE_ROW], [0, 0, 1]]), np.eye(4), SIZE
)
PERIOD_NS = 10**8


def true_depth(ahead_m, rows):
    """Depth of the road, and of a wall that stands across it, in a camera that drove `ahead_m`."""
    with np.errstate(divide="ignore"):
        road = np.where(rows > CENTRE_ROW, HEIGHT_M * FOCAL / (rows - CENTRE_ROW), np.inf)
    return np.minimum(road, WALL_M - ahead_m)


def scan(ahead_m, lines=range(25, 118, 10)):
    depth = np.zeros(SIZE, np.float32)
    for row in lines:
        depth[row, ::2] = true_depth(ahead_m, np.float64(row))
    return depth


def pose(ahead_m, origin=(0.0, 0.0, 0.0), yaw_deg=0.0):
    matrix = np.eye(4)
    cosine, sine = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    matrix[:3, :3] = [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]
    matrix[:3, 3] = np.add(origin, [0, 0, ahead_m])
    return matrix
