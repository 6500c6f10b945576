"""Checking and resizing of answers against plain loops."""

import numpy as np
import pytest

from runtime.contract.canonical_focal import CameraScale
from runtime.engine.inference import at_frame_size, output_faults
from runtime.engine.preprocess import preprocess


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("head", ["depth", "boundary", "depth_uncertainty", "semantic_logits"])
def test_one_value_that_is_not_finite_is_found_anywhere(contract, head, bad):
    for at in range(5 * 7):
        values = np.zeros((5, 7), np.float32)
        values.flat[at] = bad
        assert output_faults({head: values}, contract) == (f"{head}_not_finite",)


@pytest.mark.parametrize(("head", "limit"), [("depth", 80.0), ("boundary", 1.0)])
def test_a_value_out_of_range_is_found_anywhere(contract, head, limit):
    values = np.full((5, 7), limit / 2, np.float32)
    values[0, :2] = 0, limit
    assert output_faults({head: values}, contract) == ()
    values[0, :2] = -1e-6 * limit, limit * (1 + 1e-6)  # rounding
    assert output_faults({head: values}, contract) == ()
    for at in range(values.size):
        for bad in (-0.01 * limit, 1.01 * limit, -3e38, 3e38):
            wrong = values.copy()
            wrong.flat[at] = bad
            assert output_faults({head: wrong}, contract) == (f"{head}_out_of_range",)


def test_a_negative_uncertainty_is_found_anywhere_and_none_is_too_large(contract):
    for at in range(5 * 7):
        scale = np.zeros((5, 7), np.float32)
        scale.flat[at] = 1e6  # a model may know nothing: of no use, but true
        assert output_faults({"depth_uncertainty": scale}, contract) == ()
        scale.flat[at] = -1e-3
        assert output_faults({"depth_uncertainty": scale}, contract) == (
            "depth_uncertainty_out_of_range",
        )


def test_only_ids_with_a_name_are_valid(contract):
    semantic = np.zeros((5, 5), np.uint8)
    for highest, expected in (
        (1, ()),
        (2, ("semantic_unknown_class",)),
        (254, ("semantic_unknown_class",)),
        (255, ("semantic_not_finite",)),
    ):
        semantic[4, 4] = highest
        assert output_faults({"semantic": semantic}, contract) == expected


@pytest.mark.parametrize(("feed", "expected"), [(True, 10.2), (False, 10.0)])
def test_the_depth_of_a_large_frame_moves_to_its_own_returns(feed, expected):
    rgb, returns = np.zeros((80, 120, 3), np.uint8), np.zeros((80, 120), np.float32)
    returns[::4, ::4] = 10.2
    frame = preprocess(
        rgb,
        returns if feed else None,
        size_for=lambda size: (40, 60),
        scale_for=lambda size: CameraScale(2.0, 80.0, 500.0),
    )
    outputs = {name: np.full((40, 60), 20, np.float32) for name in ("depth", "depth_uncertainty")}
    answers = at_frame_size(outputs, frame)
    assert answers["depth"].shape == (80, 120)
    np.testing.assert_allclose(answers["depth"][8:-8, 8:-8], expected, rtol=1e-4)
    assert (answers["depth_uncertainty"][8:-8, 8:-8] < 10).all() == feed
