"""--save cloud: a PLY file a frame, where the camera is known."""

import numpy as np
import pytest

from runtime import Predictor
from runtime.recordings.folders import FolderSource

K = np.array([[60.0, 0, 20], [0, 62, 31.5], [0, 0, 1]])


@pytest.mark.parametrize("option", ["--calibration", "--focal-length"])
def test_the_command_writes_clouds(tmp_path, run, stream, all_heads, read_ply, option):
    toml = tmp_path / "camera.toml"
    toml.write_text(f"intrinsics = {K.tolist()}\nextrinsics = {np.eye(4).tolist()}\n")
    result = run(option, toml if option == "--calibration" else 62, "--save", "cloud")
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "out" / "cloud").iterdir())) == 12
    intrinsics = K if option == "--calibration" else [[62, 0, 31.5], [0, 62, 23.5], [0, 0, 1]]
    source = FolderSource(stream[0], depth=stream[1])
    frame = source.read(source.list_frames()[3])
    with Predictor(all_heads, threads=1) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    expected = prediction.points(np.array(intrinsics), frame.rgb)
    lines, points = read_ply(tmp_path / "out/cloud/f3.ply")
    np.testing.assert_allclose(points["x"], expected.points[:, 0], rtol=1e-6)
    np.testing.assert_array_equal(points["green"], expected.rgb[:, 1])
    np.testing.assert_array_equal(points["label"], expected.semantic)
    assert "comment label 0 dark 0 0 128" in lines


def test_without_a_camera_the_command_fails_before_anything_is_written(tmp_path, run):
    result = run("--save", "depth,cloud")
    assert result.exit_code == 1
    assert "--save cloud needs the camera's intrinsics: give --calibration" in result.stderr
    assert not (tmp_path / "out").exists()


def test_clouds_are_thinned_as_the_options_say(tmp_path, run, stream, all_heads, read_ply):
    thin = "--cloud-voxel", 5, "--max-uncertainty", 0.2
    done = run("--focal-length", 62, "--save", "cloud", "--limit", 1, *thin)
    assert done.exit_code == 0, done.output
    source = FolderSource(stream[0], depth=stream[1])
    frame = source.read(source.list_frames()[0])
    with Predictor(all_heads, threads=1) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    camera = np.array([[62, 0, 31.5], [0, 62, 23.5], [0, 0, 1.0]])
    expected = prediction.points(camera, frame.rgb, max_uncertainty=0.2, voxel_m=5)
    assert 0 < len(expected.points) < len(prediction.points(camera).points)
    _, points = read_ply(next((tmp_path / "out/cloud").iterdir()))
    np.testing.assert_array_equal(points["uncertainty"], expected.uncertainty)
    np.testing.assert_array_equal(points["x"], expected.points[:, 0])


def test_a_share_of_uncertainty_needs_a_model_that_answers_it(tmp_path, run, model_file):
    done = run("--max-uncertainty", 0.2, "--model", model_file())
    assert done.exit_code == 1
    assert "--max-uncertainty needs the uncertainty" in done.stderr
