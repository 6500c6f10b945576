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


@pytest.fixture
def drive(tmp_path) -> Path:
    recorded = Path(DATA or "") / "kitti_drive_0009"
    for number in range(FRAMES):
        for folder, name in (("image", f"image_02/{number:010d}.jpg"), ("points", "")):
            (tmp_path / folder).mkdir(exist_ok=True)
            if folder == "points":
                name = f"velodyne_fov/{number:010d}.bin"
            if folder == "image" or number % 2 == 0:
                (tmp_path / folder / Path(name).name).symlink_to(recorded / name)
    for name in ("poses.txt", "image_02_timestamps.txt"):
        lines = (recorded / name).read_text().splitlines(keepends=True)[:FRAMES]
        (tmp_path / name).write_text("".join(lines))
    (tmp_path / "calib").symlink_to(recorded)
    return tmp_path


def options(drive):
    return {"points": drive / "points", "calibration": drive / "calib"}


def test_moved_returns_lie_where_the_withheld_scan_has_them(drive):
    moved, as_it_is = (
        FolderSource(
            drive / "image",
            **options(drive),
            timestamps=drive / "image_02_timestamps.txt",
            **poses,
        )
        for poses in ({"poses": drive / "poses.txt", "pose_frame": PoseFrame.LIDAR}, {})
    )
    own = FolderSource(
        drive / "image",
        points=Path(DATA or "") / "kitti_drive_0009/velodyne_fov",
        calibration=drive / "calib",
    )
    errors = {}
    for name, source in (("moved", moved), ("as it is", as_it_is)):
        off = []
        for listed, truth in zip(source.list_frames(), own.list_frames(), strict=False):
            if listed.reused:
                depth, exact = (s.read(f).sparse_depth for s, f in ((source, listed), (own, truth)))
                both = (depth > 0) & (exact > 0)
                off.append(abs(depth - exact)[both])
        # Road and walls along it look the same from further on: not the median.
        errors[name] = np.percentile(np.concatenate(off), [75, 90])
    assert (errors["moved"] < 0.7 * errors["as it is"]).all(), errors
