"""Where depth could be known: regions against plain loops, errors by hand."""

import numpy as np
import pytest

from training.evaluation.depth_regions import (
    EDGE_RATIO,
    REGIONS,
    RETURN_DISTANCES,
    DepthRegionScores,
    distance_px,
    is_dense,
    split_distances,
    split_regions,
)
from training.evaluation.metrics import DepthErrors


def house():
    """A wall at 20 m with a post at 5 m in front, sky above, something beyond 100 m right."""
    depth = np.full((40, 80), 20, np.float32)
    depth[:, 30:33] = 5
    depth[:6] = 0
    depth[:, 70:] = 300
    return depth


def test_regions_and_distances_equal_loops():
    rng = np.random.default_rng(0)
    depth = house()
    fed = np.where(rng.random(depth.shape) < 0.004, depth, 0)
    fed[:, 50:] = 0
    known = (depth > 0) & (depth <= 100)
    edges = []
    for v, u in np.ndindex(depth.shape):
        rows, columns = slice(max(v - 1, 0), v + 2), slice(max(u - 1, 0), u + 2)
        around = depth[rows, columns][known[rows, columns]]
        if around.size and around.max() > EDGE_RATIO * around.min():
            edges.append((v, u))
    returns = np.argwhere(fed > 0)
    by_region, by_distance = np.empty(depth.shape, object), np.empty(depth.shape, object)
    for pixel in np.ndindex(depth.shape):
        to_edge = np.hypot(*(np.array(edges) - pixel).T).min()
        to_return = np.hypot(*(returns - pixel).T).min()
        near = "edge" if to_edge <= 3 else "interior"
        by_region[pixel] = near if to_return <= 12 else "uncovered"
        by_distance[pixel] = next(n for n, px in RETURN_DISTANCES.items() if to_return <= px)
    to_return_px = distance_px(fed > 0)
    for masks, names, expected in (
        (split_regions(depth, to_return_px), REGIONS, by_region),
        (split_distances(to_return_px), RETURN_DISTANCES, by_distance),
    ):
        assert list(masks) == list(names)
        for name, mask in masks.items():
            assert mask.any()
            np.testing.assert_array_equal(mask, expected == name)
    *near, far = split_distances(distance_px(fed < 0)).values()
    assert far.all()
    assert not np.any(near)


def test_errors_by_hand_and_merged():
    depth = house()
    fed = np.zeros_like(depth)
    fed[20, 10] = 20
    masks, known = split_regions(depth, distance_px(fed > 0)), (depth > 0) & (depth <= 100)
    answer = depth.copy()
    answer[masks["interior"]] += 1
    answer[masks["uncovered"]] -= 4
    answer[20, 10] += 2  # 3 m off
    scores, other = DepthRegionScores(), DepthRegionScores()
    scores.update(DepthErrors(answer, depth), fed)
    other.update(DepthErrors(depth, depth), fed)
    figures = scores.figures()
    count = int((masks["interior"] & known).sum())
    assert figures["mae_m_interior"] == pytest.approx((count + 2) / count)
    assert figures["rmse_m_interior"] == pytest.approx(np.sqrt((count + 8) / count))
    assert not any("edge" in name for name in figures)  # the post is farther than 12 px
    assert figures["mae_m_uncovered"] == figures["rmse_m_uncovered"] == 4
    assert figures["mae_m_return_0_px"] == 3
    scores.merge(other)
    assert scores.figures()["mae_m_uncovered"] == 2
    scanned = DepthRegionScores()
    scanned.update(DepthErrors(answer, np.where(fed > 0, fed, 0)), fed)
    assert scanned.figures().keys() == {"mae_m_return_0_px", "rmse_m_return_0_px"}


def test_rendered_depth_is_dense_and_accumulated_scans_are_not():
    rng = np.random.default_rng(0)
    assert is_dense(house())
    assert not is_dense(np.where(rng.random((40, 80)) < 0.4, house(), 0))
    assert not is_dense(np.zeros((40, 80), np.float32))
