"""Canonical depth behind any camera: the factor goes on before the model and comes off after."""

import dataclasses

import numpy as np
import pytest

from runtime import InputError, Predictor

CANONICAL_PX = 100.0
RANGE_M = 400.0
HEADS = ("semantic", "depth", "boundary", "depth_uncertainty")
OFFSET_M = 1.5  # what the graph by hand adds to what it is fed


@pytest.fixture
def canonical(model_file, contract):
    """A model file that works in the depth of a camera of 100 px, up to 400 m of it."""
    canonical = {"canonical_focal_px": CANONICAL_PX, "max_depth_m": RANGE_M}
    return model_file(contract=dataclasses.replace(contract, **canonical), heads=HEADS)


@pytest.fixture
def frame(make_frame):
    rgb, depth = make_frame()
    return rgb, np.minimum(depth, np.float32(15))


@pytest.mark.parametrize("focal", [25.0, 100.0, 731.25])
def test_metres_come_back_for_any_focal_length(canonical, frame, focal):
    """The graph copies what it is fed and adds 1.5 canonical metres."""
    rgb, depth = frame
    with Predictor(canonical, focal_length_px=focal) as predictor:
        prediction = predictor.predict(rgb, depth)
        assert predictor.focal_length_px == focal
    assert prediction.valid
    expected = depth + np.float32(OFFSET_M * focal / CANONICAL_PX)
    np.testing.assert_allclose(prediction.depth, expected, rtol=1e-6)
    np.testing.assert_allclose(prediction.depth_uncertainty, expected / 16, rtol=1e-6)
    assert prediction.depth.dtype == prediction.depth_uncertainty.dtype == np.float32
    assert prediction.depth_returns == np.count_nonzero(depth)


def test_the_focal_length_of_a_frame_goes_before_that_of_the_predictor(canonical, frame):
    with Predictor(canonical, focal_length_px=50.0) as predictor:
        one = predictor.predict(*frame, focal_length_px=300.0)
        own = predictor.predict(*frame)
    with Predictor(canonical) as predictor:  # as the canonical camera's
        none = predictor.predict(*frame)
    np.testing.assert_array_equal(none.depth, frame[1] + np.float32(OFFSET_M))
    np.testing.assert_allclose(one.depth - frame[1], OFFSET_M * 3, rtol=1e-4)
    np.testing.assert_allclose(own.depth - frame[1], OFFSET_M / 2, rtol=1e-4)


def test_the_farthest_return_is_not_lost_by_rounding(canonical, make_frame, change_run):
    """Whatever the factor, the graph must be fed what was counted: never beyond its range."""
    fed = []
    rgb, depth = make_frame()
    with Predictor(canonical) as predictor:
        change_run(lambda run, feed: fed.append(feed["sparse_depth"][0]) or run())
        for focal in np.random.default_rng(0).uniform(20, 900, 50):
            limit = np.float32(RANGE_M * focal / CANONICAL_PX)
            depth[:] = 0
            depth[5, 5:8] = np.nextafter(limit, np.float32(0)), limit, 1
            prediction = predictor.predict(rgb, depth, focal_length_px=focal)
            assert np.count_nonzero(fed[-1]) == prediction.depth_returns >= 2
            assert fed[-1].max() <= RANGE_M


@pytest.mark.parametrize("focal", [0.99, 1e7, float("nan"), "721", True])
def test_what_no_camera_has_is_refused(canonical, make_frame, focal):
    with pytest.raises(InputError, match="focal_length_px"):
        Predictor(canonical, focal_length_px=focal)
    with Predictor(canonical) as predictor:
        with pytest.raises(InputError, match="focal_length_px"):
            predictor.predict(*make_frame(), focal_length_px=focal)
        assert predictor.predict(*make_frame()).valid


def test_a_wide_cameras_far_returns_are_fed_as_at_the_end_of_the_range(
    model_file, contract, make_frame, change_run
):
    """80 canonical metres are 40 m behind a lens half as long; an answer is never farther."""
    rgb, depth = make_frame()
    depth[:] = 0
    depth[0, :3] = 30, 60, 260
    path = model_file(contract=dataclasses.replace(contract, canonical_focal_px=CANONICAL_PX))
    fed = []
    with Predictor(path, focal_length_px=50.0) as predictor:
        change_run(lambda run, feed: fed.append(feed["sparse_depth"][0]) or run())
        prediction = predictor.predict(rgb, depth)
        assert predictor.camera_scale((48, 64)) == (2.0, 40.0, 50.0)
    assert fed[0][0, :3].tolist() == [60, 80, 0]
    assert (prediction.cleaned.too_far, prediction.depth_returns) == (2, 2)
    assert prediction.range_m == 40
