"""A sample of training holds what the engine's source reads of the same recording."""

import numpy as np

from layouts import kitti_stream
from layouts.pictures import write
from runtime.sources.folders import FolderSource
from runtime.sources.kitti_raw import KittiRawSource
from training.datasets.folders import FoldersRecipe
from training.datasets.kitti_raw import KittiRaw


def assert_same(sample, frame):
    np.testing.assert_array_equal(sample.rgb, frame.rgb, strict=True)
    np.testing.assert_array_equal(sample.depth, frame.sparse_depth, strict=True)
    np.testing.assert_array_equal(sample.intrinsics, frame.calibration.intrinsics, strict=True)
    assert sample.focal_length_px == frame.calibration.focal_length_px
    assert sample.depth.any()


def test_kitti_raw(tmp_path):
    drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(2):
        rgb = rng.integers(0, 256, (8, 16, 3), np.uint8)
        write(drive / "image_02" / "data" / f"{number:010d}.png", rgb)
        points = rng.uniform([4, -4, -2, 0], [30, 4, 2, 1], (200, 4)).astype("<f4")
        points.tofile(drive / "velodyne_points" / "data" / f"{number:010d}.bin")
    kitti_stream.write_calibration(drive.parent)
    cameras = drive.parent / "calib_cam_to_cam.txt"
    cameras.write_text(cameras.read_text().replace("8 0 0 10 4 0", "8 3 0 11 4 1"))
    (drive.parent / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.3 0\n")
    samples, source = KittiRaw(tmp_path), KittiRawSource(drive)
    for index, listed in enumerate(source.list_frames()):
        assert_same(samples[index], source.read(listed))
    assert index == 1


def test_folders(tmp_path):
    rng = np.random.default_rng(0)
    for name in "ab":
        write(tmp_path / "images" / f"{name}.png", rng.integers(0, 256, (8, 16, 3), np.uint8))
        write(tmp_path / "depth" / f"{name}.png", rng.integers(0, 65536, (8, 16), np.uint16))
    intrinsics = [[50.5, 0, 8], [0, 51.0, 4], [0, 0, 1]]
    camera = tmp_path / "camera.toml"
    camera.write_text(f"intrinsics = {intrinsics}\nextrinsics = {np.eye(4).tolist()}\n")
    recipe = FoldersRecipe(path="x", depth="depth", depth_scale=1000, intrinsics=(50.5, 51, 8, 4))
    samples = recipe.open(tmp_path, "camvid")
    source = FolderSource(
        tmp_path / "images", depth=tmp_path / "depth", depth_scale=1000, calibration=camera
    )
    for index, listed in enumerate(source.list_frames()):
        assert_same(samples[index], source.read(listed))
    assert index == 1
