"""A recorded drive at 1.1 m a frame whose every second scan is missing, with its poses.

The poses are of the LiDAR; they were made from all scans, also from the missing ones.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from runtime.geometry.poses import PoseFrame
from runtime.sources.folders import FolderSource

DATA = os.environ.get("SSDNET_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
FRAMES = 20


def test_moved_returns_lie_where_the_withheld_scan_has_them(tmp_path):
    recorded = Path(DATA or "") / "kitti_drive_0009"
    (tmp_path / "image").mkdir()
    (tmp_path / "points").mkdir()
    for number in range(FRAMES):
        (tmp_path / f"image/{number}.jpg").symlink_to(recorded / f"image_02/{number:010d}.jpg")
        if number % 2 == 0:
            scan = recorded / f"velodyne_fov/{number:010d}.bin"
            (tmp_path / f"points/{number}.bin").symlink_to(scan)
    for name in ("poses.txt", "image_02_timestamps.txt"):
        lines = (recorded / name).read_text().splitlines(keepends=True)[:FRAMES]
        (tmp_path / name).write_text("".join(lines))
    given = {"calibration": recorded, "timestamps": tmp_path / "image_02_timestamps.txt"}
    poses = {"poses": tmp_path / "poses.txt", "pose_frame": PoseFrame.LIDAR}
    own = FolderSource(
        recorded / "image_02", points=recorded / "velodyne_fov", calibration=recorded
    )
    errors = []
    for moved in (poses, {}):
        source = FolderSource(tmp_path / "image", points=tmp_path / "points", **given, **moved)
        off = []
        for listed, truth in zip(source.list_frames(), own.list_frames(), strict=False):
            if listed.reused:
                depth, exact = source.read(listed).sparse_depth, own.read(truth).sparse_depth
                both = (depth > 0) & (exact > 0)
                off.append(abs(depth - exact)[both])
        # Road and walls along it look the same from further on: not the median.
        errors.append(np.percentile(np.concatenate(off), [75, 90]))
    assert (errors[0] < 0.7 * errors[1]).all(), errors
