"""Returns on the answers to an image, and the figures of how well they fit."""

import numpy as np
import pytest

from painted_street import (
    EXTRINSICS,
    scan_of,
    street,
    street_answer,
    street_frame,
    turned_extrinsics,
)
from runtime.checks.fit import FitScores, fit_of, rotation, turned
from runtime.checks.search import find_rotation, held_out_gain
from runtime.contract.degraded import IMAGE_CONSTANT
from runtime.geometry.calibration import Calibration
from runtime.streams.frame import Frame
from runtime.streams.frame_view import view_of
from runtime.streams.messages import Image


@pytest.mark.parametrize(("angles", "way"), [
    ((1, 0, 0), (1, 0, 0)), ((0, 1, 0), (0, -1, 0)), ((0, 0, 1), (0, 1, 0)),
], ids=["yaw to the right", "pitch up", "roll clockwise"])  # fmt: skip
def test_the_signs_of_the_angles(angles, way):
    """A return ahead and a little to the right moves; x is to the right and y is down."""
    before = np.array([0.5, 0, 1])
    moved = rotation(angles) @ before - before
    assert moved @ way > 0.004
    assert np.abs(np.delete(moved[:2], np.argmax(np.abs(way)))) < 0.002


@pytest.mark.parametrize("lens", [{}, {"lens": "plumb_bob", "distortion": [-0.2, 0.05, 0, 0]}])
def test_returns_meet_the_pixels_of_the_projection(lens):
    """An answer to a large image has one value for a square of pixels."""
    size = (752, 1000)
    matrix = np.array([[500.0, 0, 500], [0, 500, 376], [0, 0, 1]])
    calibration = Calibration(matrix, EXTRINSICS, size, **lens)
    image = Image(np.zeros((*size, 3), np.uint8))
    answer = street_answer(0)
    answer.depth = answer.boundary = np.ones(size, np.float32)
    view = view_of(Frame(image, street_frame(0).depth, calibration=calibration), answer)
    assert view.answer.boundary.shape == (376, 500)
    returns = np.array([[x, y, 10.0] for x in (-9.92, 0.12, 9.96) for y in (-5, 0.1, 5)])
    points = ((returns - EXTRINSICS[:3, 3]) @ EXTRINSICS[:3, :3]).astype(np.float32)
    row, column = np.nonzero(calibration.project(points, size))
    found = view.pixels((returns - EXTRINSICS[:3, 3]).astype(np.float32))
    assert set(zip(*found[:2], strict=True)) == set(zip(row // 2, column // 2, strict=True))
    assert len(row) == len(returns)


def test_the_score_of_the_right_calibration_is_largest():
    view = street(0)
    fit = fit_of(view)
    assert fit.depth_correlation == pytest.approx(1, abs=0.01)
    row, column, _ = view.pixels(view.structure[1])
    blurred = view.answer.blurred(2 / 375)
    assert fit.edge < blurred[row, column].mean() - 0.05, "the mean over all returns is subtracted"
    for angles in np.vstack([np.diag([1.5, 3, 5]), -np.diag([1.5, 3, 5])]):
        assert fit_of(view, angles).score < fit.score
        assert fit_of(turned(view, angles)) == pytest.approx(fit_of(view, angles), abs=0.01)


def test_a_wrong_unit_lowers_the_score_and_a_usual_ratio_does_not():
    right = FitScores(0.1, 0.9, 0.8, 0.0, 500)
    assert right._replace(log_ratio=np.log(1.7)).score == right.score
    assert right._replace(log_ratio=np.log(0.1)).score < right.score - 0.5


def test_a_turn_of_several_degrees_is_measured():
    right = find_rotation([street(seed) for seed in range(3)])
    turn = np.array([4, -1, 3])
    views = [street(seed, turned_extrinsics(turn)) for seed in range(3)]
    found = find_rotation(views)
    assert (np.abs(found.angles - right.angles + turn) < (0.15, 0.3, 0.6)).all()
    assert (found.error > 0.01).all(), "the frames differ"
    gain, error = held_out_gain(views)
    assert gain > 3 * error


def test_what_cannot_be_judged_is_no_view_or_has_no_structure():
    assert view_of(street_frame(0), street_answer(0, degraded=(IMAGE_CONSTANT,))) is None
    assert street(0).has_structure
    few = scan_of(np.ones((120, 360), np.float32) * 5)[:400]
    assert not street(0, points=few).has_structure
    empty_road = street(0, boxes=0)
    assert len(empty_road.structure[0]) > 500
    assert not empty_road.has_structure


def test_returns_beside_the_image_are_kept():
    """The image ends at 36.9 degrees; trials turn returns at 40 degrees into it."""
    beside = np.float32([[np.tan(np.radians(40)) * 10, 0, 10], [-20, 0, 10]]) - EXTRINSICS[:3, 3]
    points = (beside @ EXTRINSICS[:3, :3]).astype(np.float32)
    assert len(street(0, points=points).structure[0]) == 1
