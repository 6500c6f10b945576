"""A calibration is found right, off by so much, wrong in a way that has a name, or not visible."""

import re
from dataclasses import replace

import numpy as np
import pytest

from painted_street import EXTRINSICS, paint, scan_of, street, street_frame, turned_extrinsics
from runtime import InputError, Predictor, Rig, calibrate, open_source
from runtime.alignment.calibrate import Verdict, count_scenes, judge, uncertainty_of
from runtime.checks.fit import rotation
from runtime.checks.search import Optimum

TURN = np.array([2.5, -1.5, 0])


def judged(extrinsics=EXTRINSICS, **options):
    """Judge four painted streets with these extrinsics."""
    views = [street(seed, extrinsics, **options) for seed in range(4)]
    return judge(views, street_frame(0, extrinsics).calibration, street_frame(0))


def test_the_right_calibration_is_right():
    result = judged()
    assert result.verdict is Verdict.RIGHT, result.reason
    assert (np.abs(result.off_degrees) < result.within_degrees).all()
    assert (result.within_degrees[:2] < (0.7, 1.45)).all()
    assert np.isinf(result.within_degrees[2]), "four scenes do not show roll"
    assert "roll not visible" in result.reason
    assert "position as given, not tested" in result.reason
    assert re.search("fit worse: .*focal_length", result.reason)
    assert result.refined is result.given


def test_a_rotation_is_measured_and_taken_back():
    result = judged(turned_extrinsics(TURN))
    assert result.verdict is Verdict.OFF, result.reason
    assert (np.abs(result.off_degrees - TURN) < result.within_degrees).all()
    assert re.match(r"off by yaw \+2\.\d\d \+- 0.*pitch -1\.", result.reason)
    yaw, pitch, _ = result.off_degrees
    back = rotation((-yaw, -pitch, 0)) @ result.given.extrinsics[:3, :3]
    assert np.allclose(result.refined.extrinsics[:3, :3], back), "roll is not seen"
    assert np.array_equal(result.refined.extrinsics[:3, 3], EXTRINSICS[:3, 3])
    assert result.after.edge > result.before.edge


def test_only_one_axis_may_be_off():
    assert judged(turned_extrinsics((2.5, 0, 0))).verdict is Verdict.OFF


@pytest.mark.parametrize(("extrinsics", "scans", "verdict", "said"), [
    (np.linalg.inv(EXTRINSICS), None, Verdict.OTHER_READING, "take its inverse"),
    (EXTRINSICS, "0.3 s after", Verdict.OTHER_SCANS, "scans of 0.3 s after fit"),
    (EXTRINSICS, "none", Verdict.NOT_VISIBLE, "not visible: the returns fit the image nowhere"),
])  # fmt: skip
def test_another_reading_is_named_and_writes_no_calibration(extrinsics, scans, verdict, said):
    views = []
    for seed in range(4):
        points = scan_of(paint(seed + 20)) if scans else None
        beside = {scans: scan_of(paint(seed))} if scans == "0.3 s after" else {}
        views.append(street(seed, extrinsics, points=points, beside=beside))
    result = judge(views, street_frame(0, extrinsics).calibration, street_frame(0))
    assert result.verdict is verdict, result.reason
    assert said in result.reason
    assert result.finding is not None
    assert result.refined is None
    assert result.off_degrees is None


def test_the_scans_of_other_frames_beside_a_wrong_rotation_are_no_fault_of_the_pairing():
    beside = [{"the frame before": scan_of(paint(seed))} for seed in range(4)]
    views = [street(seed, turned_extrinsics(TURN), beside=beside[seed - 1]) for seed in range(4)]
    result = judge(views, street_frame(0, turned_extrinsics(TURN)).calibration, street_frame(0))
    assert result.verdict is Verdict.OFF, result.reason


def test_a_focal_length_of_other_images_is_no_rotation():
    wide = [street(0).intrinsics * [[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]]] * 4
    views = [replace(street(seed), intrinsics=wide[seed]) for seed in range(4)]
    result = judge(views, street_frame(0).calibration, street_frame(0))
    assert result.verdict is Verdict.OTHER_READING, result.reason
    assert result.finding.name == "focal_length"


def test_alternatives_are_those_of_the_distance():
    """An error of position turns a jump at z by the angle d / z."""
    result = judged()
    range_m = result.range_m
    depths = np.concatenate([street(seed).structure[1][:, 2] for seed in range(4)])
    assert range_m == pytest.approx(np.reciprocal(np.reciprocal(depths).mean()), rel=0.01)
    sideways, height = replace(result, off_degrees=np.array([1.0, 2.0, 0])).alternatives
    assert f"a position {np.tan(np.radians(1)) * range_m:.2f} m off sideways" in sideways
    assert f"(0.1 m as {np.degrees(np.arctan(0.1 / range_m)):.2f} degrees)" in sideways
    assert "cx 4 px off (1.2% of the width)" in sideways
    assert "cy 8 px off" in height
    assert replace(result, off_degrees=None).alternatives == ()


def test_the_uncertainty_has_a_floor_and_student_s_quantiles():
    best = Optimum(np.zeros(3), np.full(3, 0.1))
    for frames, quantile in ((4, 3.182), (20, 2.093)):
        scatter, one = uncertainty_of(best, frames, scenes=1)
        assert scatter == pytest.approx(quantile * best.error, rel=0.03)
        _, many = uncertainty_of(best, frames, scenes=1e9)
        assert (many >= (0.2, 0.4, 0.8)).all(), "what all frames have in common"
        assert (one > 1.5 * many).all(), "the same scene again shows nothing new"


def test_frames_of_one_scene_count_once():
    one, other = street(0), street(1)
    assert count_scenes([one] * 3) == pytest.approx(1, abs=1e-3)
    assert 1.5 < count_scenes([one, one, other, other]) < 2.2
    assert count_scenes([]) == 1


def test_without_enough_frames_nothing_is_said():
    views = [street(seed) for seed in range(2)]
    result = judge(views, street_frame(0).calibration, street_frame(0))
    assert result.verdict is Verdict.NOT_VISIBLE
    assert result.reason.startswith("not visible: 2 frames have structure")


def test_models_without_boundaries_and_frames_without_scans_are_refused(
    recording, frames, model_file, predictor
):
    images, _, points, _, calibration, *_ = recording(frames[:3])
    with open_source("folders", images, Rig(calibration=calibration), points=points) as source:
        with (
            Predictor(model_file(heads=("semantic", "depth"))) as other,
            pytest.raises(InputError, match="no boundary: a calibration is checked with a"),
        ):
            calibrate(source, other)
        with pytest.raises(InputError, match="frames must be"):
            calibrate(source, predictor, frames=2)
    with (
        open_source("folders", images) as source,
        pytest.raises(InputError, match="the recording has no scans: give `points="),
    ):
        calibrate(source, predictor)
