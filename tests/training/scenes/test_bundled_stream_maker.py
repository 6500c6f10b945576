"""A rendered scene becomes a folder pair that the engine's reader takes."""

import numpy as np
import pytest

from layouts.virtual_kitti import write_second_edition
from runtime.base.errors import DatasetError
from runtime.recordings.folders import FolderSource
from training.scenes.bundled_stream_maker import write_lidar_stream


def test_frames_pair_up_and_hold_metres(tmp_path):
    """Rows 16 to 63 show a wall 12.34 m ahead."""
    variant = write_second_edition(tmp_path / "scenes", frames=1, magnify=8)
    (variant / "intrinsic.txt").write_text("frame cameraID fx fy cx cy\n0 0 300 300 64 20\n")
    assert write_lidar_stream(variant, tmp_path / "out") == 1
    source = FolderSource(tmp_path / "out" / "rgb", depth=tmp_path / "out" / "depth")
    (listed,) = source.list_frames()
    depth = source.read(listed).sparse_depth
    returns = depth[depth > 0]
    assert 0.01 < len(returns) / depth.size < 0.5
    np.testing.assert_allclose(returns, 12.34, atol=0.15)  # range noise of 2 cm
    assert not depth[:16].any()  # sky returns nothing, nor what is 655 m away
    picture = variant / "frames" / "rgb" / "Camera_0" / "rgb_00000.jpg"
    assert listed.image.read_bytes() == picture.read_bytes()


def test_missing_scene_is_named(tmp_path):
    with pytest.raises(DatasetError, match="Scene9"):
        write_lidar_stream(tmp_path / "Scene9" / "fog", tmp_path / "out")
