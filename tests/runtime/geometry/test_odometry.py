import os
import sys
from pathlib import Path

import numpy as np
import pytest

from runtime import InputError, read_scan
from runtime.geometry.odometry import Odometry

DATA = os.environ.get("SSDNET_DATA")


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp.config", None)
    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    with pytest.raises(InputError, match=r"kiss-icp .*\.\[odometry\]"):
        Odometry()


def test_points_that_are_no_returns_are_left_out():
    pytest.importorskip("kiss_icp")
    rng = np.random.default_rng(0)
    walls = rng.uniform(-20, 20, (4000, 3)).astype(np.float32)
    walls[:2000, 0], walls[2000:, 1] = 20, -20
    nothing = np.zeros((50, 3), np.float32)
    spoilt = np.concatenate([walls, nothing, nothing + np.float32(np.nan)])
    clean, marked = Odometry(), Odometry()
    for ahead_m in (0.0, 0.5, 1.0):
        shift = np.float32([ahead_m, 0, 0])
        expected, pose = clean.add(walls - shift), marked.add(spoilt - shift)
    np.testing.assert_allclose(pose, expected, atol=1e-4)
    np.testing.assert_array_equal(marked.add(np.zeros((0, 3), np.float32)), pose)


@pytest.mark.skipif(not DATA, reason="set SSDNET_DATA")
def test_the_way_of_a_recorded_drive():
    pytest.importorskip("kiss_icp")
    drive, odometry = Path(DATA) / "kitti_drive_0009", Odometry()
    scans = sorted((drive / "velodyne_fov").glob("*.bin"))[:15]
    found = [odometry.add(read_scan(scan)) for scan in scans]
    rows = [np.array(line.split(), float) for line in (drive / "poses.txt").open()]
    expected = np.stack(rows)[14, [3, 7, 11]] - np.stack(rows)[4, [3, 7, 11]]
    way = found[14][:3, 3] - found[4][:3, 3]
    assert np.linalg.norm(way - expected) < 0.01 * np.linalg.norm(expected)
