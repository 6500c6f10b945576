"""Errors of depth by the distance to the nearest return: against plain loops, and by hand."""

import numpy as np
import pytest

from training.scores.depth_regions import RETURN_DISTANCES, distance_px, split_distances
from training.scores.metrics import DepthErrors, DepthScores


def test_distances_equal_loops():
    fed = np.zeros((40, 80))
    fed.flat[np.random.default_rng(0).choice(fed.size, 12, replace=False)] = 20
    fed[:, 50:] = 0
    expected = np.empty(fed.shape, object)
    for pixel in np.ndindex(fed.shape):
        to_return = np.hypot(*(np.argwhere(fed > 0) - pixel).T).min()
        expected[pixel] = next(n for n, px in RETURN_DISTANCES.items() if to_return <= px)
    masks = split_distances(distance_px(fed > 0))
    assert list(masks) == list(RETURN_DISTANCES)
    for name, mask in masks.items():
        assert mask.any()
        np.testing.assert_array_equal(mask, expected == name)
    *near, far = split_distances(distance_px(fed < 0)).values()
    assert far.all()
    assert not np.any(near)


def test_errors_by_hand_and_merged():
    depth = np.full((1, 10), 20.0)
    depth[0, 9] = 0  # unknown
    fed = np.where(np.arange(10) == 0, depth, 0)
    answer = depth + np.array([3, 1, 1, 0, 0, 0, 2, -4, 4, 9])
    scores, other = DepthScores(), DepthScores()
    scores.update(DepthErrors(answer, depth), fed=fed)
    other.update(DepthErrors(depth, depth), fed=fed)
    figures = scores.figures()
    assert figures["mae_m_return_0_px"] == 3
    assert figures["mae_m_return_1_2_px"] == 1
    assert figures["mae_m_return_3_6_px"] == pytest.approx(2 / 4)
    assert figures["rmse_m_return_3_6_px"] == pytest.approx(1)
    assert figures["mae_m_return_over_6_px"] == 4
    scores.merge(other)
    assert scores.figures()["mae_m_return_over_6_px"] == 2
