"""The first frames of a run show a calibration that is wrong by a degree."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from painted_street import EXTRINSICS, street_answer, street_frame
from runtime.alignment.fit_scores import rotation
from runtime.alignment.quick_check import Fit, QuickCheck
from runtime.app.run.cli import app


def finding_of(angles, *, boxes=9, answer=street_answer):
    extrinsics = EXTRINSICS.copy()
    extrinsics[:3, :3] = rotation(angles) @ EXTRINSICS[:3, :3]
    check = QuickCheck()
    for seed in range(5):
        check.add(street_frame(seed, extrinsics, boxes=boxes), answer(seed))
    return check.finding()


@pytest.mark.parametrize(("wrong", "fit", "text"), [
    ((0, 0, 0), Fit.BEST_AS_GIVEN, "better as given"),
    ((1.5, 0, 0), Fit.BETTER_TURNED, "turned by -1 degree of yaw"),
    ((0, -1.5, 0), Fit.BETTER_TURNED, "turned by +1 degree of pitch"),
])  # fmt: skip
def test_the_turn_that_fits_better_is_named(wrong, fit, text):
    finding = finding_of(wrong)
    assert finding.fit is fit, finding
    assert text in finding.text


def test_nothing_is_said_where_nothing_is_seen():
    """No return is in the image; or the model sees a plane without an edge."""
    assert finding_of((90, 0, 0)) is None

    def plane(seed):
        flat = np.full((120, 360), 10, np.float32)
        return SimpleNamespace(depth=flat, boundary=0 * flat, valid=True, degraded=())

    assert finding_of((0, 0, 0), answer=plane).fit is Fit.NOT_VISIBLE


NANO = ("--model", "ssdnet-nano", "--warmup", "0")


def test_a_run_reports_it(tmp_path, recording, frames, turned):
    given, page = (
        recording([turned(frame, (0, 2, 0)) for frame in frames[:3]]),
        tmp_path / "run.html",
    )
    given += ["--out", str(tmp_path / "out"), "--save", "none", "--report", str(page), *NANO]
    result = CliRunner().invoke(app, given)
    line = "calibration: the returns fit the images better turned by -1 degree of pitch"
    assert line in result.stdout, result.output
    report = json.loads((tmp_path / "out/report.json").read_text())
    found = report["frames"]["calibration_fit"]
    assert found["fit"] == "better_turned"
    assert found["turned"]["pitch"][0] > found["figure"] > found["turned"]["pitch"][1]
    assert line in page.read_text()


@pytest.mark.parametrize("axes", [np.eye(4), np.diag([-1, -1, 1, 1.0])])
def test_a_run_names_the_mistake_where_returns_fit_nowhere(tmp_path, recording, frames, axes):
    """The inverse matrix, with no return in the image; and a half turn."""
    wrong = []
    for frame in frames[:3]:
        right = frame.calibration.extrinsics
        given = np.linalg.inv(right) if axes[0, 0] == 1 else right @ axes
        wrong.append(replace(frame, calibration=replace(frame.calibration, extrinsics=given)))
    given = [*recording(wrong), "--out", str(tmp_path / "out"), "--save", "none", *NANO]
    result = CliRunner().invoke(app, given)
    words = "camera to LiDAR: take its inverse" if axes[0, 0] == 1 else "180 degrees about its z"
    assert words in " ".join(result.output.split()), result.output
    assert result.exit_code == 3
