"""A rendered scene becomes a folder pair that the engine's reader takes."""

import cv2
import numpy as np
import pytest

from runtime.errors import DatasetError
from runtime.sources.folders import FolderSource
from training.scenes.bundled_stream_maker import write_lidar_stream

FILES = (
    "frames/rgb/Camera_0/rgb_00007.jpg",
    "frames/depth/Camera_0/depth_00007.png",
    "frames/classSegmentation/Camera_0/classgt_00007.png",
)


@pytest.fixture
def variant(tmp_path):
    """One frame of a wall 12.5 m ahead under a sky, in the Virtual KITTI 2 layout."""
    folder = tmp_path / "scenes" / "Scene1" / "clone"
    depth = np.full((64, 128), 1250, np.uint16)
    depth[:30] = 65535
    road = np.full((64, 128, 3), (100, 60, 100), np.uint8)
    for file, image in zip(FILES, (road, depth, road), strict=True):
        (folder / file).parent.mkdir(parents=True)
        cv2.imwrite(str(folder / file), image)
    (folder / "colors.txt").write_text("Category r g b\nRoad 100 60 100\n")
    (folder / "intrinsic.txt").write_text("frame cameraID fx fy cx cy\n7 0 300 300 64 20\n")
    return folder


def test_frames_pair_up_and_hold_metres(variant, tmp_path):
    assert write_lidar_stream(variant, tmp_path / "out") == 1
    source = FolderSource(tmp_path / "out" / "rgb", depth=tmp_path / "out" / "depth")
    (listed,) = source.list_frames()
    frame = source.read(listed)
    returns = frame.sparse_depth[frame.sparse_depth > 0]
    assert 0.01 < len(returns) / frame.sparse_depth.size < 0.5
    np.testing.assert_allclose(returns, 12.5, atol=0.15)  # range noise of 2 cm
    assert not frame.sparse_depth[:30].any()  # sky returns nothing
    assert listed.image.read_bytes() == (variant / FILES[0]).read_bytes()


def test_missing_scene_is_named(tmp_path):
    with pytest.raises(DatasetError, match="no such folder"):
        write_lidar_stream(tmp_path / "a" / "Scene9" / "fog", tmp_path / "out")
