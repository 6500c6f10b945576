"""Checking and resizing of answers against plain loops."""

import numpy as np
import pytest

from runtime.contract.canonical_focal import CameraScale
from runtime.contract.heads import HEADS
from runtime.engine.inference import at_frame_size, output_faults
from runtime.engine.preprocess import preprocess


@pytest.mark.parametrize(("head", "usual", "bad", "fault"), [
    *((head, 0, bad, "not_finite")
      for head in ("depth", "boundary", "depth_uncertainty", "semantic_logits")
      for bad in (np.nan, np.inf, -np.inf)),
    *(("depth", 40, bad, "out_of_range") for bad in (-0.8, 80.8, -3e38, 3e38)),
    *(("boundary", 0.5, bad, "out_of_range") for bad in (-0.01, 1.01, -3e38, 3e38)),
    ("depth_uncertainty", 0, -1e-3, "out_of_range"), ("semantic", 0, 2, "unknown_class"),
    ("semantic", 0, 254, "unknown_class"), ("semantic", 0, 255, "not_finite"),
])  # fmt: skip
def test_one_wrong_value_is_found_anywhere(contract, head, usual, bad, fault):
    for at in range(5 * 7):
        values = np.full((5, 7), usual, HEADS[head].dtype)
        values.flat[at] = bad
        assert output_faults({head: values}, contract) == (f"{head}_{fault}",)


@pytest.mark.parametrize(("head", "values"), [
    ("depth", (0, 80)), ("depth", (-8e-5, 80.00008)), ("boundary", (0, 1)),  # rounding is no fault
    ("boundary", (-1e-6, 1 + 1e-6)), ("semantic", (0, 1)),
    ("depth_uncertainty", (0, 1e6)),  # a model may know nothing: of no use, but true
])  # fmt: skip
def test_values_within_the_limits_are_right(contract, head, values):
    assert output_faults({head: np.array([values], HEADS[head].dtype)}, contract) == ()


@pytest.mark.parametrize(("feed", "expected"), [(True, 10.2), (False, 10.0)])
def test_the_depth_of_a_large_frame_moves_to_its_own_returns(feed, expected):
    rgb, returns = np.zeros((80, 120, 3), np.uint8), np.zeros((80, 120), np.float32)
    returns[::4, ::4] = 10.2
    fed, scale = returns if feed else None, CameraScale(2.0, 80.0, 500.0)
    frame = preprocess(rgb, fed, size_for=lambda _: (40, 60), scale_for=lambda _: scale)
    outputs = {name: np.full((40, 60), 20, np.float32) for name in ("depth", "depth_uncertainty")}
    answers = at_frame_size(outputs, frame)
    assert answers["depth"].shape == (80, 120)
    np.testing.assert_allclose(answers["depth"][8:-8, 8:-8], expected, rtol=1e-4)
    assert (answers["depth_uncertainty"][8:-8, 8:-8] < 10).all() == feed
