"""A frozen, black or overexposed camera, and lost parts of a LiDAR, against the frames before."""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime.checks.frame_health import FrameHealth
from runtime.recordings.images import read_sparse_depth

SIZE = (128, 416)
NOTHING = np.zeros((60, 80), np.float32)


def noise(seed, low=0, high=256, size=(60, 80)):
    return np.random.default_rng(seed).integers(low, high, (*size, 3), dtype=np.uint8)


def check_image(rgb, health=None):
    return (health or FrameHealth()).check(rgb, NOTHING)


def scan(seed=0):
    """64 lines in the lower two thirds, a return in every third column, a tenth missing."""
    rng = np.random.default_rng(seed)
    depth = np.zeros(SIZE, np.float32)
    depth[44:128:2, ::3] = rng.uniform(2, 80, (42, 139))
    depth[rng.random(SIZE) < 0.1] = 0
    return depth


@pytest.fixture
def check_depth():
    """Check depth maps of a LiDAR, each with another image."""
    health, seeds = FrameHealth(), iter(range(1000))
    return lambda depth, **options: health.check(
        noise(next(seeds), size=depth.shape), depth, **options
    )


@pytest.fixture
def check_learned(check_depth):
    """The same after eight healthy scans."""
    assert [check_depth(scan(seed)) for seed in range(8)] == [()] * 8
    return check_depth


def test_identical_bytes_are_frozen_and_one_other_byte_is_not():
    health = FrameHealth()
    rgb = noise(0)
    other = rgb.copy()
    other[33, 41, 1] ^= 1  # where not every pixel is looked at
    assert check_image(rgb, health) == ()
    assert check_image(rgb.copy(), health) == ("image_frozen",)
    assert check_image(other, health) == ()
    assert check_image(other.copy(), health) == ("image_frozen",)
    assert check_image(other[:40].copy(), health) == (), "another size"


@pytest.mark.parametrize(("low", "high", "white", "expected"), [
    (0, 13, np.s_[:0], ("image_black",)), (0, 30, np.s_[:0], ()), (200, 256, np.s_[:0], ()),
    (0, 10, np.s_[:8, :8], ()),  # a light at night
    (250, 256, np.s_[:0], ("image_overexposed",)),
    (30, 200, np.s_[:24], ()), (30, 200, np.s_[:32], ("image_overexposed",)),  # of 60 rows
])  # fmt: skip
def test_dark_and_bright_images(low, high, white, expected):
    rgb = noise(0, low, high)
    rgb[white] = 255
    assert check_image(rgb) == expected


@pytest.mark.parametrize("nothing_m", [0, 655.35, np.inf, np.nan, -1])
def test_a_lost_sector(check_learned, nothing_m):
    """Whatever stands for no return, as 65535 of a 16-bit PNG."""
    depth = scan(9)
    depth[:, 100:160] = nothing_m
    assert [check_learned(depth) for _ in range(50)] == [("lidar_sector_lost",)] * 50, "not learned"
    assert check_learned(scan(10)) == ()


@pytest.mark.parametrize("range_m", [400, 80])
def test_returns_count_up_to_the_farthest_one_of_the_range(check_depth, range_m):
    far = np.where(scan() > 0, np.float32(300), np.float32(0))
    assert [check_depth(far, range_m=range_m) for _ in range(8)] == [()] * 8
    far[:, 100:160] = 0
    lost = ("lidar_sector_lost",) if range_m == 400 else ()
    assert check_depth(far, range_m=range_m) == lost


@pytest.mark.parametrize(("part", "found"), [
    (np.s_[100:], ("lidar_lines_lost",)), (np.s_[44:128:4], ("lidar_lines_lost",)),
    (np.s_[:], ()), (np.s_[60:100, 200:215], ()),
], ids=["at an edge", "between", "all: no_depth in degraded", "a dark car"])  # fmt: skip
def test_lost_lines(check_learned, part, found):
    depth = scan(9)
    depth[part] = 0
    assert check_learned(depth) == found


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="needs SSDNET_DATA/kitti_stream")
def test_a_recorded_drive_is_healthy_until_a_part_is_lost(check_depth):
    folder = Path(os.environ["SSDNET_DATA"]) / "kitti_stream" / "sparse_depth_02"
    depths = [read_sparse_depth(path) for path in sorted(folder.iterdir())]
    assert [check_depth(depth) for depth in depths] == [()] * 60
    blind = depths[-1].copy()
    blind[:, 300:450] = 0
    assert check_depth(blind) == ("lidar_sector_lost",)


def street(frame):
    """An image that changes as in a drive."""
    ramp = np.linspace(0, 127, SIZE[1]).astype(np.uint8)[:, None]
    return np.roll(noise(0, size=SIZE) // 2 + ramp, 30 * frame, 1)


def points(seed=0):
    return np.random.default_rng(seed).uniform(2, 80, (500, 4)).astype(np.float32)


def test_a_lidar_that_repeats_itself_is_frozen_from_the_third_scan_on():
    health, depth = FrameHealth(), scan()
    found = [health.check(street(i), depth, scan=points()) for i in range(5)]
    assert found == [(), (), *[("lidar_frozen",)] * 3]
    assert health.check(street(5), depth, scan=points(1)) == ()
    times = np.full((500, 1), 7, np.float32)  # a further column is not compared
    timed = [np.hstack([points(2)[:, :3], times * i]) for i in range(3)]
    found = [health.check(street(i), depth, scan=each) for i, each in enumerate(timed)]
    assert found[2] == ("lidar_frozen",)


def test_no_lidar_is_frozen_that_stands_still_or_whose_scans_serve_twice():
    health, depth = FrameHealth(), scan()
    rng = np.random.default_rng(1)
    for _ in range(5):  # a simulator: the image has noise
        image = street(0) // 2 + rng.integers(0, 8, (*SIZE, 3), np.uint8)
        assert health.check(image, depth, scan=points()) == ()
    for frame in range(8):  # each scan twice, and reused ones between
        assert health.check(street(frame), depth, scan=points(20 + frame // 2)) == ()
        assert health.check(street(frame), depth, reused=True) == ("image_frozen",)
    for frame in range(4):  # equal maps of scans that differ
        assert health.check(street(frame), depth, scan=points(10 + frame)) == ()


def test_a_lidar_is_missing_or_empty():
    health, empty = FrameHealth(), np.zeros(SIZE, np.float32)
    assert health.check(street(0), empty) == (), "a camera alone"
    assert health.check(street(1), empty, scan=points()) == ("lidar_empty",)
    assert health.check(street(2), empty) == ("lidar_missing",)
    assert health.check(street(3), scan(), scan=points()) == ()
    assert FrameHealth(has_lidar=True).check(street(0), empty) == ("lidar_missing",)


def test_a_lidar_with_another_pattern_in_every_scan_loses_no_lines():
    health, rng = FrameHealth(), np.random.default_rng(0)
    for frame in range(40):
        depth = np.zeros(SIZE, np.float32)
        first = 30 if frame % 2 else 45  # its upper edge is reached in every second scan alone
        depth[rng.integers(first, 110, 4000), rng.integers(0, SIZE[1], 4000)] = 10
        assert health.check(noise(frame, size=SIZE), depth) == (), frame
    assert health.check(
        noise(99, size=SIZE), np.where(np.arange(SIZE[1]) < 60, 0, depth).astype(np.float32)
    ) == ("lidar_sector_lost",)
