"""Marks of no return, and arrays that are no points, beside scans that look like them."""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime import InputError, project_points
from runtime.geometry.assumptions import collect_assumptions
from runtime.geometry.returns import check_farthest, check_points, is_return
from runtime.recordings.scan import read_scan
from runtime.streams.messages import Scan

DATA = os.environ.get("SSDNET_DATA")
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


def dome(range_m, n=600):
    """Points on a part of a sphere."""
    rays = np.float32(RNG.normal(size=(n, 3)) * [1, 1, 0.2])
    rays *= np.float32(range_m) / np.linalg.norm(rays, axis=1, keepdims=True)
    return np.hstack([rays, np.ones((n, 1), np.float32)])


@pytest.mark.parametrize(("ranges", "count"), [
    ([120.0], 2000), ([0.05], 2000), ([0.05, 120.0], 2000), ([150.0], 0), ([0.9], 300),
])  # fmt: skip
def test_many_points_at_the_edge_of_the_range_met_nothing(ranges, count):
    scan = np.vstack([SCAN[:count], *map(dome, ranges)])
    order = RNG.permutation(len(scan))
    np.testing.assert_array_equal(is_return(scan[order]), order < count)
    if min(ranges) > 100:  # many formats store centimetres
        np.testing.assert_array_equal(is_return(scan.round(2)[order]), order < count)
    assert Scan.of(scan).lost == 600 * len(ranges)


def test_what_looks_like_misses_is_returns():
    ring = dome(30, 1000)
    rough = dome(120) * RNG.uniform(0.95, 1, (600, 1)).astype(np.float32)  # a cut at 120 m
    copies = np.tile(np.float32([[200, 3, 1, 1]]), (300, 1))
    few = dome(120, 30)
    level = dome(0.9) * [1, 1, 0, 1]  # one line of a simulated LiDAR on a plane
    level *= 4 / np.linalg.norm(level[:, :2], axis=1, keepdims=True)
    level = np.float32(level - np.array([0, 0, 1.8, 0]))
    far = SCAN * 5  # behind and before the ring
    steps = np.round(np.linalg.norm(SCAN[:, :3], axis=1, keepdims=True) / 0.04) * np.float32(0.04)
    stepped = dome(1, 2000) * steps.astype(np.float32)  # a LiDAR that counts in 4 cm
    for scan in (np.vstack([far, ring]), *(np.vstack([SCAN, x]) for x in (rough, copies, few))):
        assert is_return(scan).all()
    behind = SCAN[np.linalg.norm(SCAN[:, :3], axis=1) > 5]
    assert is_return(np.vstack([behind, level])).all()
    assert is_return(stepped)[np.linalg.norm(stepped[:, :3], axis=1) > 0.01].all()


def test_depth_maps_that_end_at_a_far_plane_are_said():
    road = np.linspace(5, 79, 6400, dtype=np.float32).reshape(64, 100) * RNG.uniform(
        0.9, 1, (64, 100)
    )
    road = road.astype(np.float32)
    clipped, wall = road.copy(), np.full_like(road, 10)
    clipped[:16] = 100
    notes = []
    with collect_assumptions(notes):
        for depth in (road, wall, np.zeros_like(road), np.minimum(road, 70), road[:1, :20]):
            check_farthest(depth)
        assert not notes
        check_farthest(clipped)
    assert "if 100 m is the end of the sensor's range" in notes[0]


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
@pytest.mark.parametrize(("folder", "columns"), [
    ("kitti_stream/velodyne_fov", 4), ("view_of_delft/velodyne", 4), ("pandaset_front/points", 6),
])  # fmt: skip
def test_recorded_scans_have_no_misses(folder, columns):
    for path in sorted(Path(DATA, folder).iterdir())[:5]:
        assert is_return(read_scan(path, columns=columns)).all()
