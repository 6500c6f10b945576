"""What a run finds of its calibration: in the terminal, the report, the page and the exit code."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import PushStream, replay
from runtime.app.run.cli import app
from runtime.app.run.options import RunOptions, UsageError
from runtime.base.errors import InputError

NANO = ("--model", "ssdnet-nano", "--warmup", "0", "--save", "none")


@pytest.fixture
def run(tmp_path, recording):
    """Run on frames; gives the result and the report's "frames"."""

    def invoke(frames, *more):
        given = [*recording(frames), "--out", str(tmp_path / "out"), *NANO, *more]
        result = CliRunner().invoke(app, given)
        report = json.loads((tmp_path / "out/report.json").read_text())
        return result, report["frames"]

    return invoke


def inverted(frame):
    calibration = frame.calibration
    matrix = np.linalg.inv(calibration.extrinsics)
    return replace(frame, calibration=replace(calibration, extrinsics=matrix))


@pytest.mark.parametrize("accept", [False, True])
def test_a_fault_flags_frames_and_ends_with_3_unless_it_is_accepted(run, frames, accept):
    more = ("--accept", "inverse_extrinsics") if accept else ()
    result, report = run([inverted(each) for each in frames[:3]], *more)
    said = "camera to LiDAR: take its inverse"
    assert (said in result.stderr) == (not accept), result.output
    assert result.exit_code == (0 if accept else 3)
    assert [each["name"] for each in report["findings"]] == (
        [] if accept else ["inverse_extrinsics"]
    )
    assert report["accepted"] == (["inverse_extrinsics"] if accept else [])
    assert ("implausible_depth" in report["degraded"]) == (not accept)


@pytest.mark.parametrize("fails", [False, True])
def test_a_warning_ends_with_0_or_by_fail_on_with_5(tmp_path, run, frames, turned, fails):
    page = tmp_path / "run.html"
    more = ("--fail-on", "calibration") if fails else ()
    wrong = [turned(frame, (0, 2, 0)) for frame in frames[:5]]
    result, report = run(wrong, "--page", str(page), *more)
    line = "the returns fit the images better turned by -2 degrees of pitch"
    assert f"warning: {line}" in result.stderr, result.output
    assert result.exit_code == (5 if fails else 0)
    (finding,) = report["findings"]
    assert (finding["name"], finding["severity"]) == ("turned", "warning")
    assert finding["evidence"]["better by"] > 0.06
    assert report["implausible_depth"] is None
    assert "turned" in report["readings"]["tested"]
    assert line in page.read_text()


def test_names_of_no_finding_are_refused(frames, predictor):
    with pytest.raises(UsageError, match=r"--accept takes some of .*got 'dark'"):
        RunOptions(demo=True, accept=["dark"])
    with pytest.raises(InputError, match="accept takes names of findings, got 'dark'"):
        PushStream(predictor, accept=["dark"])
    with pytest.raises(InputError, match="accept takes names of findings, got 'dark'"):
        replay(predictor, [], accept=["dark"])
