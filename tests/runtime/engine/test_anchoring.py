"""A predicted depth of a large camera moves to the returns that agree with it."""

import numpy as np
import pytest

from runtime.engine.anchoring import AGREE, anchor, move_to_returns

SMALL, LARGE = (40, 60), (108, 162)


def plane(value=20.0):
    return np.full(SMALL, value, np.float32)


def returns_of(depth_m, every=4, columns=slice(None)):
    returns = np.zeros(LARGE, np.float32)
    returns[2::every, columns][:, ::every] = depth_m
    return returns


def test_the_depth_passes_through_returns_that_agree():
    factors = anchor(plane(), returns_of(20.4))
    np.testing.assert_allclose(factors.ratio[2:-2, 2:-2], 1.02, atol=1e-4)
    assert factors.uncertainty.max() < 1


@pytest.mark.parametrize("ratio", [0.0, np.exp(2 * AGREE)])
def test_returns_of_another_surface_and_no_returns_change_nothing(ratio):
    depth, uncertainty, returns = plane(), np.ones(SMALL, np.float32), returns_of(20 * ratio)
    assert anchor(depth, returns) is None
    move_to_returns(depth, uncertainty, returns, range_m=80.0)
    assert (depth == 20).all()
    assert (uncertainty == 1).all()


def test_no_ratio_crosses_an_edge_of_the_answer():
    depth = plane()
    depth[:, 30:] = 40
    left_alone = returns_of(20.4, columns=slice(0, 78))
    ratio = anchor(depth, left_alone).ratio
    assert (ratio[:, 30:] == 1).all()
    np.testing.assert_allclose(ratio[4:-4, 4:26], 1.02, atol=2e-3)


def test_a_return_is_compared_with_the_depth_at_its_exact_place():
    """The road is slanted, so that the depth changes by several per cent in each row."""
    rows = np.arange(LARGE[0]) * SMALL[0] / LARGE[0] + 0.5 * (SMALL[0] / LARGE[0] - 1)
    road = (1 / (0.02 + 0.002 * np.arange(SMALL[0], dtype=np.float32))).astype(np.float32)
    depth = np.repeat(road[:, None], SMALL[1], axis=1)
    returns = np.zeros(LARGE, np.float32)
    returns[4:-4, ::3] = (1 / (0.02 + 0.002 * rows[4:-4]))[:, None]
    np.testing.assert_allclose(anchor(depth, returns).ratio, 1, atol=1e-4)


def test_answers_without_uncertainty_and_depths_of_zero_are_taken():
    depth = plane()
    depth[:5] = 0
    move_to_returns(depth, None, returns_of(20.4), range_m=80.0)
    assert (depth[:3] == 0).all()
    assert depth[20, 30] == pytest.approx(20.4, rel=1e-3)


def test_no_depth_is_moved_beyond_the_range():
    depth = plane(79.0)
    depth[:, 20:40] = 80
    move_to_returns(depth, None, returns_of(80.0), range_m=80.0)
    assert depth.max() == 80
    assert depth.min() > 79
