"""--save cloud: a PLY file a frame, where the camera is known."""

import json

import numpy as np
import pytest

from runtime import InputError, Predictor
from runtime.io.calibration import Calibration
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.sources.folders import FolderSource
from runtime.sources.frames import Frame

K = np.array([[60.0, 0, 20], [0, 62, 31.5], [0, 0, 1]])


@pytest.fixture
def toml(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(f"intrinsics = {K.tolist()}\nextrinsics = {np.eye(4).tolist()}\n")
    return path


def test_a_frames_own_calibration_comes_first():
    frame = Frame(np.zeros((60, 80, 3), np.uint8), np.zeros((60, 80), np.float32))
    centred = intrinsics_of(frame, 50.0)
    np.testing.assert_array_equal(centred, [[50, 0, 39.5], [0, 50, 29.5], [0, 0, 1]])
    with pytest.raises(InputError, match="give --calibration or --focal-length"):
        intrinsics_of(frame, None)
    for size in (None, (60, 80)):
        calibrated = Frame(
            frame.rgb, frame.sparse_depth, calibration=Calibration(K, np.eye(4), size)
        )
        assert intrinsics_of(calibrated, 50.0) is calibrated.calibration
    other = Calibration(K, np.eye(4), (60, 81))
    with pytest.raises(
        InputError, match=r"of \(60, 81\) \(height, width\), got an image of \(60, 80\)"
    ):
        Frame(frame.rgb, frame.sparse_depth, calibration=other)


def test_the_cloud_of_a_frame(tmp_path, make_writer, answered, read_ply):
    frame, prediction = answered
    writer = make_writer(tmp_path / "out", 50.0, kinds=("depth", "cloud"))
    writer.write(frame, prediction)
    lines, points = read_ply(tmp_path / "out/cloud/a.ply")
    expected = prediction.points(intrinsics_of(frame, 50.0), frame.rgb)
    assert len(points) == len(expected.points) > 0
    np.testing.assert_array_equal(points["z"], expected.points[:, 2])
    np.testing.assert_array_equal(points["green"], expected.rgb[:, 1])
    np.testing.assert_array_equal(points["label"], expected.semantic)
    assert "comment label 0 dark 0 0 128" in lines


def test_a_camera_that_is_not_known_leaves_nothing_of_the_frame(tmp_path, make_writer, answered):
    writer = make_writer(tmp_path / "out", kinds=("depth", "cloud"))
    with pytest.raises(InputError, match="--calibration"):
        writer.write(*answered)
    assert not list((tmp_path / "out").glob("*/*"))


@pytest.mark.parametrize("option", ["--calibration", "--focal-length"])
def test_the_command_writes_clouds(tmp_path, run, stream, model_file, toml, read_ply, option):
    result = run(option, toml if option == "--calibration" else 62, "--save", "cloud")
    assert result.exit_code == 0, result.output
    clouds = tmp_path / "out" / "cloud"
    assert len(list(clouds.iterdir())) == 12
    assert json.loads((tmp_path / "out/report.json").read_text())["saved"] == ["cloud"]
    source = FolderSource(
        stream[0], depth=stream[1], calibration=toml if option == "--calibration" else None
    )
    frame = source.read(source.list_frames()[3])
    with Predictor(tmp_path / "model.onnx", threads=1) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    expected = prediction.points(intrinsics_of(frame, 62.0))
    _, points = read_ply(clouds / "f3.ply")
    np.testing.assert_allclose(points["x"], expected.points[:, 0], rtol=1e-6)


def test_without_a_camera_the_command_fails_before_anything_is_written(tmp_path, run):
    result = run("--save", "depth,cloud")
    assert result.exit_code == 1
    assert "--save cloud needs the camera's intrinsics: give --calibration" in result.stderr
    assert not (tmp_path / "out").exists()


def test_all_is_all_but_the_clouds(tmp_path, run):
    assert run("--focal-length", 60, "--limit", 1).exit_code == 0
    assert not (tmp_path / "out" / "cloud").exists()


def test_clouds_are_replaced_with_their_run(tmp_path, run):
    assert run("--focal-length", 60, "--save", "cloud", "--limit", 3).exit_code == 0
    assert run("--focal-length", 60, "--save", "cloud", "--limit", 1, "--overwrite").exit_code == 0
    assert [path.name for path in (tmp_path / "out/cloud").iterdir()] == ["f0.ply"]
