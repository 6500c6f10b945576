"""A calibration is found right, off by so much, wrong in a way that has a name, or not visible."""

from dataclasses import replace

import numpy as np
import pytest

from runtime import InputError, Predictor, Rig, calibrate, open_source
from runtime.alignment.calibrate import Verdict, judge
from runtime.alignment.figures import rotation
from runtime.alignment.view import points_in_time, view_of

# Of the recording of `frames`.
EXTRINSICS = np.array([[0, -1, 0, 0.3], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])


@pytest.fixture
def judged(frames, answers):
    """Judge four frames with other extrinsics, or with other scans."""

    def run(extrinsics=EXTRINSICS, *, later=0, change=lambda points: points):
        views = []
        for index in range(4):
            calibration = replace(frames[index].calibration, extrinsics=extrinsics)
            frame = replace(frames[index], calibration=calibration)
            beside = points_in_time(frame) if later else None
            view = view_of(frame, answers[index], (beside, None))
            views.append(view.with_scan(change(points_in_time(frames[index + later]))))
        return judge(views, calibration, frame)

    return run


def test_the_right_calibration_is_right(judged):
    result = judged()
    assert result.verdict is Verdict.RIGHT, result.reason
    assert (np.abs(result.off_degrees) < result.within_degrees)[:2].all()
    assert (result.within_degrees[:2] < (0.7, 1.45)).all()
    assert result.refined is result.given
    assert "0.1 m as" in result.alternatives[0]


@pytest.mark.parametrize("wrong", [(2.5, -1, 0), (-1, 2, 0)])
def test_a_rotation_is_measured_and_taken_back(judged, wrong):
    extrinsics = EXTRINSICS.copy()
    extrinsics[:3, :3] = rotation(wrong) @ extrinsics[:3, :3]
    result = judged(extrinsics)
    assert result.verdict is Verdict.OFF, result.reason
    assert (np.abs(result.off_degrees - wrong) < result.within_degrees).all()
    assert np.abs(result.refined.extrinsics - EXTRINSICS)[:3, 2].max() < np.radians(0.7)
    assert np.array_equal(result.refined.extrinsics[:3, 3], EXTRINSICS[:3, 3])
    assert result.after.edge > result.before.edge


QUARTER = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


@pytest.mark.parametrize(
    ("extrinsics", "words"),
    [
        (np.linalg.inv(EXTRINSICS), "camera to LiDAR"),
        (np.eye(4), "axes of camera (z ahead) and LiDAR (x ahead, z up)"),
        (EXTRINSICS @ np.diag([-1, -1, 1, 1.0]), "turned by 180 degrees about its z axis"),
        (EXTRINSICS @ QUARTER, "turned by 270 degrees about its z axis"),
        (EXTRINSICS * [1, 1, 1, 100], "in centimetres"),
    ],
)
def test_a_usual_mistake_is_named_and_undone(judged, extrinsics, words):
    extrinsics = extrinsics.copy()
    extrinsics[3, 3] = 1
    result = judged(extrinsics)
    assert result.verdict is Verdict.OFF
    assert words in result.reason
    assert words in result.mistake
    assert np.abs(result.refined.extrinsics - EXTRINSICS)[:3, :3].max() < 0.05


def test_scans_of_other_frames_are_no_rotation(judged):
    result = judged(later=3)
    assert result.verdict is Verdict.OTHER_SCANS, result.reason
    assert "the frames before" in result.reason
    assert result.refined is None


def test_nothing_is_said_of_scans_that_fit_nowhere(judged):
    random = np.random.default_rng(0)

    def shuffle(points):
        ranges = np.linalg.norm(points, axis=1, keepdims=True)
        return (points / ranges * random.permutation(ranges)).astype(np.float32)

    result = judged(change=shuffle)
    assert result.verdict is Verdict.NOT_VISIBLE, result.reason
    assert result.refined is None
    assert result.off_degrees is None


def test_a_source_is_judged_by_its_frames(recording, frames, predictor, turned):
    images, _, points, _, calibration, *_ = recording([turned(each, (0, 2, 0)) for each in frames])
    done = []
    with open_source("folders", images, Rig(calibration=calibration), points=points) as source:
        result = calibrate(source, predictor, frames=4, on_frame=lambda: done.append(1))
    assert result.verdict is Verdict.OFF, result.reason
    assert abs(result.off_degrees[1] - 2) < result.within_degrees[1]
    assert len(done) == len(result.frames) == 4
    assert len(set(result.frames)) == 4


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
