"""`ssdnet-calibrate`, and the files that it writes."""

from contextlib import nullcontext
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from painted_street import street_frame
from runtime.alignment.calibrate import CalibrationResult, Verdict
from runtime.app.tools import calibrate as tool
from runtime.app.tools.calibrate import app, format_static_transform, format_toml
from runtime.checks.fit import FitScores, rotation
from runtime.checks.judge import Judgement
from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import quaternion_of
from runtime.recordings.source import Source


def test_the_written_calibration_is_the_right_one(tmp_path, recording, frames, turned):
    given = recording([turned(each, (2, 0, 0)) for each in frames[:4]])
    out, picture = tmp_path / "right.toml", tmp_path / "check.png"
    given += ["--frames", "4", "--out", str(out), "--picture", str(picture)]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 4, result.output
    assert "calibration: off by yaw +" in result.stdout
    assert "\n4 frames, as good as " in result.stdout
    assert "--frame-id camera --child-frame-id lidar" in result.stdout
    right, known = Calibration.from_file(out), frames[0].calibration
    between = right.extrinsics[:3, :3] @ known.extrinsics[:3, :3].T
    assert np.abs(between[0, 2]) < np.radians(0.6), "yaw"
    assert np.allclose(right.extrinsics[:3, 3], known.extrinsics[:3, 3])
    drawn = cv2.imread(str(picture))
    assert drawn.shape[1] == 1280
    assert drawn.std() > 10


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the command on cameras whose result is known."""

    def invoke(verdict, *more, cameras=1):
        frame, angles = street_frame(200), np.array([2.0, 0, 0])
        refined = frame.calibration if verdict in (Verdict.RIGHT, Verdict.OFF) else None
        result = CalibrationResult(
            verdict=verdict, reason="the reason", given=frame.calibration, refined=refined,
            off_degrees=angles, within_degrees=angles, finding=None, judgement=Judgement(),
            before=FitScores(), after=FitScores(), range_m=10.0, frames=("0",), scenes=1.0,
            example=frame,
        )  # fmt: skip
        source = MagicMock(notes=(), lidar_place=("cam", "velo", np.array([1.0, 2, 3])))
        source.__enter__.return_value = source
        invoke.source = source
        monkeypatch.setattr(tool, "calibrate", lambda *_, **__: result)
        monkeypatch.setattr(tool, "Predictor", lambda **_: nullcontext())
        opened = {str(number): source for number in range(cameras)}
        monkeypatch.setattr(Source, "open_cameras", lambda *_, **__: opened)
        cv2.imwrite(str(tmp_path / "image.png"), frame.rgb)
        files = {"--out": tmp_path / "out.toml", "--picture": tmp_path / "x.png"}
        given = [word for item in files.items() for word in map(str, item)]
        return CliRunner().invoke(app, [str(tmp_path / "image.png"), *given, *more])

    return invoke


@pytest.mark.parametrize(("verdict", "code", "is_written"), [
    (Verdict.RIGHT, 0, True), (Verdict.NOT_VISIBLE, 3, False), (Verdict.OFF, 4, True),
    (Verdict.OTHER_SCANS, 4, False),
])  # fmt: skip
def test_each_verdict_has_its_exit_code_and_files(tmp_path, run, verdict, code, is_written):
    result = run(verdict)
    assert result.exit_code == code, result.output
    assert (tmp_path / "out.toml").exists() is is_written
    line = "--x 1 --y 2 --z 3 "
    assert (line in result.stdout) == (verdict is Verdict.OFF)
    if is_written:
        text = (tmp_path / "out.toml").read_text()
        assert line in text, "the position in /tf_static"
        assert text.count("--frame-id cam --child-frame-id velo") == 1
    drawn = cv2.imread(str(tmp_path / "x.png"))
    given_once = drawn.shape[0] < 900
    assert given_once == (verdict is not Verdict.OFF)
    is_image = (np.abs(drawn[30:400].astype(int) - 200) < 2).all(axis=-1)
    assert 0.05 < is_image.mean() < 0.9, "returns are drawn on the image"


def test_a_camera_is_checked_by_itself_and_rectified_on_request(run):
    result = run(Verdict.RIGHT, cameras=2)
    assert result.exit_code == 1
    assert "2 cameras are named: check each by itself" in result.output
    assert run.source.close.call_count == 2
    for options in ([], ["--rectify", "--overwrite"]):
        assert run(Verdict.RIGHT, *options).exit_code == 0
        assert run.source.rectify_images.called == bool(options)
    assert "replace it with --overwrite" in run(Verdict.RIGHT).output, "nothing is replaced unasked"


@pytest.mark.parametrize(("more", "words"), [
    (["--out", "right.yaml"], "--out writes .toml files"),
    (["--picture", "x.gif"], "--picture writes .jpg files"), (["--frames", "2"], "--frames"),
])  # fmt: skip
def test_wrong_options_are_usage_errors(tmp_path, recording, frames, more, words):
    result = CliRunner().invoke(app, recording(frames[:1]) + more)
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())


def test_a_calibration_survives_its_file(tmp_path):
    body = np.eye(4)
    body[:3, 3] = 0.1, 0.2, 1.7
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = rotation((10, 20, 30))
    matrix = np.array([[700.5, 0, 320], [0, 701, 240], [0, 0, 1]])
    lens = {"lens": "plumb_bob", "distortion": [-0.3, 0.1, 0, 0, 0.01]}
    calibration = Calibration(matrix, extrinsics, (480, 640), body, **lens)
    (tmp_path / "car.toml").write_text(format_toml(calibration, "two\nlines"))
    read = Calibration.from_file(tmp_path / "car.toml")
    for name in ("intrinsics", "extrinsics", "body_from_lidar", "size", "lens", "distortion"):
        assert np.array_equal(getattr(read, name), getattr(calibration, name)), name


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (10, -20, 30), (180, 0, 0), (0, 179.9, 0), (0, 0, -90)]
)
def test_the_transform_of_ros_is_the_matrix(angles):
    matrix = rotation(angles)
    w, x, y, z = quaternion_of(matrix)
    assert np.allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), matrix, atol=1e-9)
    line = format_static_transform(matrix, np.array([1, 2, 3.5]), ("cam", "velo"))
    assert "--x 1 --y 2 --z 3.5 --qw" in line
    assert line.endswith("--frame-id cam --child-frame-id velo")
    assert f"--qw {w:.9g} " in line
