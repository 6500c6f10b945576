"""Marks of no return, and arrays that are no points, beside scans that look like them."""

import numpy as np
import pytest

from runtime import InputError, project_points
from runtime.geometry.returns import check_points, is_return

RNG = np.random.default_rng(0)
SCAN = (RNG.normal(size=(2000, 4)) * [20, 20, 3, 1]).astype(np.float32)
LARGEST = np.finfo(np.float32).max


@pytest.mark.parametrize("mark", [
    (0, 0, 0), (-0.0, 0, 0), (1e-9, 0, -1e-9), (np.nan, 1, 1), (1, np.inf, 1), (1, 1, -np.inf),
    (LARGEST, 1, 1), (-LARGEST, -LARGEST, -LARGEST), (2e4, 0, 0),
])  # fmt: skip
def test_a_mark_is_no_return_wherever_the_lidar_is(mark):
    points = SCAN.copy()
    points[::9, :3] = mark
    expected = np.arange(len(points)) % 9 > 0
    np.testing.assert_array_equal(is_return(points), expected)
    to_camera = np.float64([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    to_camera[:3, 3] = 0.1, 0.2, 1.2  # a mark would be a return at 1.2 m
    intrinsics = np.array([[30.0, 0, 40], [0, 30, 20], [0, 0, 1]])
    found = project_points(points, intrinsics, to_camera, (40, 80))
    np.testing.assert_array_equal(
        found, project_points(points[expected], intrinsics, to_camera, (40, 80))
    )
    assert (found > 0).sum() > 50


def as_float32(array):
    return np.frombuffer(np.ascontiguousarray(array).tobytes(), np.float32).reshape(-1, 4)


NO_SCANS = {
    "float64": as_float32(SCAN.astype(np.float64)),
    "int32 of mm": as_float32((SCAN * 1000).astype(np.int32)),
    "int16 of cm": as_float32((SCAN * 100).astype(np.int16)),
    "big-endian": as_float32(SCAN.astype(">f4")),
    "mm": SCAN * 2000,
}


@pytest.mark.parametrize("name", NO_SCANS)
def test_numbers_that_are_no_points_are_refused(name):
    with pytest.raises(InputError, match="points"):
        is_return(NO_SCANS[name])


def only(share):
    return np.where(RNG.random((2000, 1)) < share, SCAN, 0)


SCANS = {
    "empty": SCAN[:0],
    "a covered lens: no return": only(0),
    "an empty road: few returns": only(0.01),
    "organised with NaN": np.where(RNG.random((2000, 1)) < 0.1, SCAN, np.float32(np.nan)),
    "planar": SCAN * np.float32([1, 1, 0, 1]),
    "rounded to a plane": SCAN * np.float32([1, 1, 1e-20, 1]),
    "one broken record": np.vstack([SCAN, np.float32([[1e30, 1e20, 5, 1]])]),
    "far returns of 1 km": SCAN * 10,
}


@pytest.mark.parametrize("name", SCANS)
def test_scans_that_look_like_none_are_taken(name):
    scan = SCANS[name]
    distance = np.linalg.norm(scan[:, :3].astype(np.float64), axis=1)
    np.testing.assert_array_equal(is_return(scan), (distance > 0) & (distance < 1e4))


@pytest.mark.parametrize(("shape", "text"), [
    ((3, 17), "use points.T"), ((4, 400), "use points.T"), ((400, 2), r"got \(400, 2\)$"),
    ((3, 3), None), ((4, 5), None), ((3, 16), None), ((0, 3), None), ((400, 20), None),
])  # fmt: skip
def test_points_come_one_a_row(shape, text):
    points = np.ones(shape, np.float32)
    if text is None:
        check_points(points)
        return
    with pytest.raises(InputError, match=text):
        check_points(points)
