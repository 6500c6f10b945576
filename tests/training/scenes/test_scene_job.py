"""The folder layout read back, and the command that writes it."""

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex", reason="the renderer needs the train extra")

from typer.testing import CliRunner

from layouts import open_set
from runtime.base.errors import OutputError
from training.scenes.cli import app
from training.scenes.rendering.lidar_scan import LidarScan
from training.scenes.rendering.render import RenderedFrame
from training.scenes.scene_job import write_variant


def frame(number: int) -> RenderedFrame:
    rng = np.random.default_rng(number)
    depth = np.full((40, 64), 12.344, np.float32)
    depth[:10] = 0
    depth[39] = 700.0
    label = (np.arange(40)[:, None] * np.ones((1, 64)) % 18).astype(np.uint8)
    rgb = np.full((40, 64, 3), (200, 90, 30), np.uint8) + rng.integers(0, 3, (40, 64, 3), np.uint8)
    pose = np.eye(4)
    pose[:3, 3] = (1.5, -2.25, number)
    intrinsics = np.array([[50.0, 0, 32], [0, 51, 20], [0, 0, 1]])
    scan = LidarScan(np.full((5, 4), 0.5, np.float32), pose)
    return RenderedFrame(rgb, depth, label, pose, intrinsics, scan)


def test_poses_depth_and_scans_are_written_as_they_are(tmp_path):
    folder = write_variant(tmp_path / "Scene01/fog", [frame(3)])
    depth = cv2.imread(str(folder / "frames/depth/Camera_0/depth_00000.png"), cv2.IMREAD_UNCHANGED)
    assert np.unique(depth[10:]).tolist() == [1234, 65534]
    assert (depth[:10] == 65535).all()
    header, row = (folder / "extrinsic.txt").read_text().splitlines()
    assert header.startswith("frame cameraID r1,1 r1,2 r1,3 t1 r2,1")
    assert np.array_equal(
        np.reshape(row.split()[2:], (4, 4)).astype(float), frame(3).world_to_camera
    )
    name, *numbers = (folder / "calib.txt").read_text().split()
    assert name == "Tr_velo_to_cam:"
    assert np.array(numbers, float).tolist() == frame(3).scan.to_camera[:3].ravel().tolist()
    stored = np.fromfile(folder / "frames/lidar/Camera_0/lidar_00000.bin", "<f4").reshape(-1, 4)
    assert np.array_equal(stored, frame(3).scan.points)
    assert [p.name for p in folder.parent.iterdir()] == ["fog"]


def test_an_existing_variant_is_replaced_when_asked_and_a_foreign_file_never(tmp_path):
    folder = write_variant(tmp_path / "Scene01/clone", [frame(0), frame(1)])
    with pytest.raises(OutputError, match="clone"):
        write_variant(folder, [frame(0)])
    assert len(open_set("rendered", tmp_path)) == 2
    write_variant(folder, [frame(0)], overwrite=True)
    assert len(open_set("rendered", tmp_path)) == 1
    (folder / "frames" / "thesis.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"thesis\.txt"):
        write_variant(folder, [frame(0)], overwrite=True)
    assert (folder / "frames" / "thesis.txt").read_text() == "mine"
    assert len(open_set("rendered", tmp_path)) == 1


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.slow
def test_the_command_renders_scenes_in_turn_of_the_variants(tmp_path):
    small = ("--size", "32x64", "--frames", 2, "--stride", 10, "--seed", 40, "--street", "town")
    done = run(tmp_path, "--scenes", 2, "--variant", "fog", "--variant", "rain", *small)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "Scene40" / "fog").is_dir()
    assert (tmp_path / "Scene41" / "rain").is_dir()
    assert len(open_set("rendered", tmp_path)) == 4
    again = run(tmp_path, "--scenes", 1, "--variant", "fog", *small)
    assert again.exit_code == 1
    assert "exists already" in again.output
