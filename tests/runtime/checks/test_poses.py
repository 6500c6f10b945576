"""Poses that contradict the scans that they move, and the reading of them that does not."""

import numpy as np
import pytest

from car_poses import drive
from runtime.checks.poses import PosedScan, PoseJudge
from runtime.geometry.poses import PoseTrack

N = 16


def street():
    """Points of posts and of the ground, float64 (N, 4), of the world."""
    rng = np.random.default_rng(0)
    feet = rng.uniform([-5, -25], [60, 25], (60, 2))
    posts = np.repeat(feet, 60, axis=0) + rng.uniform(-0.4, 0.4, (3600, 2))
    ground = rng.uniform([-5, -25], [60, 25], (2000, 2))
    points = np.vstack([
        np.c_[posts, rng.uniform(-1.7, 4, len(posts))], np.c_[ground, np.full(len(ground), -1.7)]
    ])  # fmt: skip
    return np.c_[points, np.ones(len(points))]


WORLD = street()


def finding(read, *, turn=0.0, moves=True):
    """The verdict on a drive whose poses are what `read` makes of the right ones."""
    right, stamps = drive(N, step_ms=100, speed=10, turn=turn or 1e-9)
    right = right if moves else [np.eye(4)] * N
    track = PoseTrack.of([read(each) for each in right], stamps)
    judging = PoseJudge()
    for stamp, each in zip(stamps, right, strict=True):
        seen = (WORLD @ np.linalg.inv(each).T)[:, :3].astype(np.float32)
        seen = seen[np.argsort(-np.linalg.norm(seen, axis=1))]
        judging.add(PosedScan(seen, stamp, stamp), track)
    found = judging.finding()
    return found and found.text


def scaled(factor):
    def read(matrix):
        matrix = matrix.copy()
        matrix[:3, 3] *= factor
        return matrix

    return read


def w_first(matrix):
    """Return the pose that a reader of x, y, z, w makes of w, x, y, z, for a turn about z."""
    half = np.arctan2(matrix[1, 0], matrix[0, 0]) / 2
    x, w = np.cos(half), np.sin(half)
    read = matrix.copy()
    read[:3, :3] = [[1, 0, 0], [0, 1 - 2 * x * x, -2 * x * w], [0, 2 * x * w, 1 - 2 * x * x]]
    return read


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_right_poses_are_not_doubted(turn):
    assert finding(lambda matrix: matrix, turn=turn) is None
    assert finding(lambda matrix: matrix, moves=False) is None


@pytest.mark.parametrize(("read", "turn", "said"), [
    (np.linalg.inv, 0.0, "as their inverse"), (np.linalg.inv, 0.4, "as their inverse"),
    (scaled(0.001), 0.0, "in kilometres"), (scaled(1000), 0.0, "in millimetres"),
    (w_first, 0.4, "with w as the first number"),
])  # fmt: skip
def test_the_reading_that_fits_is_named(read, turn, said):
    found = finding(read, turn=turn)
    assert found is not None
    assert said in found


def test_poses_of_another_drive_are_far_worse_than_none():
    def other(matrix):
        matrix = matrix.copy()
        matrix[:3, 3] = 0, 3 * matrix[0, 3], 0
        return matrix

    assert "another" in (finding(other) or "")
