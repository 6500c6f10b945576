"""The reader and the command on a real camera + LiDAR stream."""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime.sources.folders import FolderSource

DATA = os.environ.get("SSDNET_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")


@pytest.fixture
def kitti() -> Path:
    return Path(DATA) / "kitti_stream"


def projected(points, calibration, size):
    """Velodyne returns (n, 4) as a depth map [m], by the formula of the recording's README."""
    matrices = {
        key: np.array(values.split(), dtype=float)
        for key, _, values in (line.partition(":") for line in calibration.splitlines())
        if key in ("P_rect_02", "R_rect_00", "velo_to_cam_R", "velo_to_cam_T")
    }
    rotation, shift = matrices["velo_to_cam_R"].reshape(3, 3), matrices["velo_to_cam_T"]
    camera = matrices["R_rect_00"].reshape(3, 3) @ (rotation @ points[:, :3].T + shift[:, None])
    projection = matrices["P_rect_02"].reshape(3, 4)
    u, v, w = projection[:, :3] @ camera + projection[:, 3:]
    columns, rows = np.floor(u / w).astype(int), np.floor(v / w).astype(int)
    inside = (w > 0) & (rows >= 0) & (rows < size[0]) & (columns >= 0) & (columns < size[1])
    depth = np.full(size, np.inf)
    np.minimum.at(depth, (rows[inside], columns[inside]), w[inside])
    return np.where(np.isinf(depth), 0, depth)


def test_the_depth_maps_are_the_lidar_in_metres(kitti):
    """The files were projected from the returns that are also there: two ways to one map."""
    calibration = (kitti / "calib_2011_09_26.txt").read_text()
    source = FolderSource(kitti / "image_02", depth=kitti / "sparse_depth_02")
    for listed in source.list_frames(limit=3):
        frame = source.read(listed)
        assert frame.rgb.shape == (375, 1242, 3)
        points = np.fromfile(kitti / "velodyne_fov" / f"{listed.name}.bin", np.float32)
        expected = projected(points.reshape(-1, 4), calibration, (375, 1242))
        assert np.array_equal(frame.sparse_depth > 0, expected > 0)
        assert abs(frame.sparse_depth - expected).max() < 0.51 / 256  # the file's rounding
