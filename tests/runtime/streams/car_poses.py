"""Exact poses of a car."""

import numpy as np
from scipy.spatial.transform import Rotation

MS = 1_000_000
DAY_NS = 86_400 * 1000 * MS


def pose(position=(0, 0, 0), rotvec=(0, 0, 0)):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    matrix[:3, 3] = position
    return matrix


def drive(count, *, step_ms=10, speed=15.0, turn=0.5, start_ns=0):
    """Poses on a circle: (poses, stamps)."""
    times = np.arange(count) * step_ms / 1e3
    angles, radius = turn * times, speed / turn
    poses = [
        pose((radius * np.sin(angle), radius * (1 - np.cos(angle)), 0), (0, 0, angle))
        for angle in angles
    ]
    return poses, [start_ns + n * step_ms * MS for n in range(count)]
