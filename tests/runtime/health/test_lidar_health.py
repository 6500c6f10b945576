import os
from pathlib import Path

import numpy as np
import pytest

from runtime.health.lidar_health import LidarHealth
from runtime.io.images import read_sparse_depth

SIZE = (128, 416)


def scan(seed=0):
    """64 lines in the lower two thirds, a return in every third column, a tenth missing."""
    rng = np.random.default_rng(seed)
    depth = np.zeros(SIZE, np.float32)
    depth[44:128:2, ::3] = rng.uniform(2, 80, (42, 139))
    depth[rng.random(SIZE) < 0.1] = 0
    return depth


def learned():
    health = LidarHealth()
    assert [health.check(scan(seed)) for seed in range(8)] == [()] * 8
    return health


@pytest.mark.parametrize("nothing_m", [0, 655.35, np.inf, np.nan, -1])
def test_a_lost_sector(nothing_m):
    """Whatever stands for no return, as 65535 of a 16-bit PNG."""
    depth = scan(9)
    depth[:, 100:160] = nothing_m
    health = learned()
    assert [health.check(depth) for _ in range(50)] == [("lidar_sector_lost",)] * 50, "not learned"
    assert health.check(scan(10)) == ()


@pytest.mark.parametrize("range_m", [400, 80])
def test_returns_count_up_to_the_farthest_one_of_the_range(range_m):
    far = np.where(scan() > 0, np.float32(300), np.float32(0))
    health = LidarHealth()
    assert [health.check(far, range_m=range_m) for _ in range(8)] == [()] * 8
    far[:, 100:160] = 0
    lost = ("lidar_sector_lost",) if range_m == 400 else ()
    assert health.check(far, range_m=range_m) == lost


def test_lost_lines_at_an_edge_and_between_others():
    depth = scan(9)
    depth[100:] = 0
    assert learned().check(depth) == ("lidar_lines_lost",)
    depth = scan(9)
    depth[44:128:4] = 0
    assert learned().check(depth) == ("lidar_lines_lost",)


def test_no_failure():
    health = learned()
    assert health.check(np.zeros(SIZE, np.float32)) == (), "reported as no_depth by degraded"
    depth = scan(9)
    depth[60:100, 200:215] = 0  # a dark car
    assert health.check(depth) == ()
    assert LidarHealth().check(scan()[:, ::-1]) == (), "nothing is known yet"


@pytest.mark.parametrize("value", [np.nan, np.inf, -1])
def test_values_that_are_no_returns_do_not_count(value):
    depth = scan(9)
    depth[:, 100:160] = value
    assert learned().check(depth) == ("lidar_sector_lost",)


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="needs SSDNET_DATA/kitti_stream")
def test_a_recorded_drive_is_healthy_until_a_part_is_lost():
    health = LidarHealth()
    folder = Path(os.environ["SSDNET_DATA"]) / "kitti_stream" / "sparse_depth_02"
    depths = [read_sparse_depth(path) for path in sorted(folder.iterdir())]
    assert [health.check(depth) for depth in depths] == [()] * 60
    blind = depths[-1].copy()
    blind[:, 300:450] = 0
    assert health.check(blind) == ("lidar_sector_lost",)
