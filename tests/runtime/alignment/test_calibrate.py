"""A calibration is found right, off by so much, wrong in a way that has a name, or not visible."""

import re
from dataclasses import replace

import numpy as np
import pytest

from painted_street import EXTRINSICS, street, street_frame
from runtime import InputError, Predictor, Rig, calibrate, open_source
from runtime.alignment.calibrate import Verdict, count_scenes, judge, uncertainty_of
from runtime.alignment.fit_scores import rotation
from runtime.alignment.search import Optimum

TURN = np.array([2.5, -1.5, 0])


def turned_extrinsics():
    extrinsics = EXTRINSICS.copy()
    extrinsics[:3, :3] = rotation(TURN) @ EXTRINSICS[:3, :3]
    return extrinsics


def judged(extrinsics=EXTRINSICS, **options):
    """Judge four painted streets with these extrinsics."""
    views = [street(seed, extrinsics, **options) for seed in range(4)]
    return judge(views, views[0].calibration, street_frame(0))


def test_the_right_calibration_is_right():
    result = judged()
    assert result.verdict is Verdict.RIGHT, result.reason
    assert (np.abs(result.off_degrees) < result.within_degrees).all()
    assert (result.within_degrees[:2] < (0.7, 1.45)).all()
    assert np.isinf(result.within_degrees[2]), "four scenes do not show roll"
    assert "roll not visible" in result.reason
    assert result.refined is result.given


def test_a_rotation_is_measured_and_taken_back():
    result = judged(turned_extrinsics())
    assert result.verdict is Verdict.OFF, result.reason
    assert (np.abs(result.off_degrees - TURN) < result.within_degrees).all()
    assert re.match(r"off by yaw \+2\.\d\d \+- 0.*pitch -1\.", result.reason)
    yaw, pitch, _ = result.off_degrees
    back = rotation((-yaw, -pitch, 0)) @ result.given.extrinsics[:3, :3]
    assert np.allclose(result.refined.extrinsics[:3, :3], back), "roll is not seen"
    assert np.array_equal(result.refined.extrinsics[:3, 3], EXTRINSICS[:3, 3])
    assert result.after.edge > result.before.edge


def test_only_one_axis_may_be_off():
    extrinsics = EXTRINSICS.copy()
    extrinsics[:3, :3] = rotation((2.5, 0, 0)) @ EXTRINSICS[:3, :3]
    assert judged(extrinsics).verdict is Verdict.OFF


@pytest.mark.filterwarnings("ignore:assumed the LiDAR is")
def test_a_usual_mistake_is_undone_before_the_rotation_is_judged():
    """A position in centimetres, with which some returns still meet the image."""
    far = EXTRINSICS.copy()
    far[:3, 3] = 12, 5, 3
    right = far.copy()
    right[:3, 3] /= 100
    result = judged(far, right=right)
    assert result.verdict is Verdict.OFF, result.reason
    assert result.reason.startswith(result.mistake)
    assert "in centimetres" in result.mistake
    assert np.allclose(result.refined.extrinsics, right)


def test_alternatives_are_those_of_the_distance():
    """An error of position turns a jump at z by the angle d / z."""
    result = judged()
    range_m = result.range_m
    depths = np.concatenate([street(seed).jumps[:, 2] for seed in range(4)])
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
    result = judge(views, views[0].calibration, street_frame(0))
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
        pytest.raises(InputError, match="the recording has no scans: give --points"),
    ):
        calibrate(source, predictor)
