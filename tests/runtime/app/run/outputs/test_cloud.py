"""--save cloud: a PLY file a frame, where the camera is known."""

import numpy as np
import pytest

from runtime import Predictor
from runtime.recordings.folders import FolderSource

K = np.array([[60.0, 0, 20], [0, 62, 31.5], [0, 0, 1]])
CENTRED = np.array([[62, 0, 31.5], [0, 62, 23.5], [0, 0, 1.0]])


@pytest.mark.parametrize(("option", "camera", "thin"), [
    ("--calibration", K, {}), ("--focal-length", CENTRED, {}),
    ("--focal-length", CENTRED, {"cloud_voxel": 5, "max_uncertainty": 0.2}),
])  # fmt: skip
def test_clouds_are_written(tmp_path, run, stream, all_heads, read_ply, option, camera, thin):
    toml = tmp_path / "camera.toml"
    toml.write_text(f"intrinsics = {K.tolist()}\nextrinsics = {np.eye(4).tolist()}\n")
    given = [option, toml if option == "--calibration" else 62, "--save", "cloud"]
    for name, value in thin.items():
        given += [f"--{name.replace('_', '-')}", value]
    result = run(*given)
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "out" / "cloud").iterdir())) == 12
    source = FolderSource(stream[0], depth=stream[1])
    frame = source.read(source.list_frames()[3])
    with Predictor(all_heads, threads=1) as predictor:
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    options = {"voxel_m": thin.get("cloud_voxel"), "max_uncertainty": thin.get("max_uncertainty")}
    expected = prediction.points(camera, frame.rgb, **options)
    assert (0 < len(expected.points) < len(prediction.points(camera).points)) == bool(thin)
    lines, points = read_ply(tmp_path / "out/cloud/f3.ply")
    np.testing.assert_allclose(points["x"], expected.points[:, 0], rtol=1e-6)
    np.testing.assert_array_equal(points["green"], expected.rgb[:, 1])
    np.testing.assert_array_equal(points["label"], expected.semantic)
    np.testing.assert_array_equal(points["uncertainty"], expected.uncertainty)
    assert "comment label 0 dark 0 0 128" in lines


@pytest.mark.parametrize(("option", "value", "text"), [
    ("--save", "depth,cloud", "--save cloud needs the camera's intrinsics: give --calibration"),
    ("--max-uncertainty", 0.2, "--max-uncertainty needs the uncertainty"),
])  # fmt: skip
def test_what_cannot_be_made_is_an_error(tmp_path, run, model_file, option, value, text):
    result = run(option, value, "--model", model_file())
    assert (result.exit_code, text in result.stderr) == (1, True)
    assert not (tmp_path / "out").exists()
