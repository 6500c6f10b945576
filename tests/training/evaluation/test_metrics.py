"""Table 1's metrics against plain loops and cases by hand."""

import math

import numpy as np
import pytest

from training.evaluation.metrics import (
    BoundaryScores,
    DepthScores,
    DisparityScores,
    Errors,
    RoadScores,
    SemanticScores,
)


def test_semantic_metrics_by_hand():
    #            label 0 0 0 0   1 1   2   ignored
    scores = SemanticScores(5)
    scores.update(
        np.array([[0, 0, 0, 1, 1, 3, 2, 0]], dtype=np.uint8),
        np.array([[0, 0, 0, 0, 1, 1, 2, 255]], dtype=np.uint8),
    )
    metrics = scores.compute()
    # IoU: 3/4, 1/3, 1/1, 0/1 (class 3 only predicted); class 4 is nowhere and left out.
    assert metrics.class_iou[:4] == pytest.approx((3 / 4, 1 / 3, 1.0, 0.0))
    assert math.isnan(metrics.class_iou[4])
    assert metrics.mean_iou == pytest.approx((3 / 4 + 1 / 3 + 1) / 4)
    assert metrics.accuracy == pytest.approx(5 / 7)
    assert metrics.mean_accuracy == pytest.approx((3 / 4 + 1 / 2 + 1) / 3)
    assert metrics.frequency_weighted_iou == pytest.approx((4 * 3 / 4 + 2 / 3 + 1) / 7)


def test_confusion_matrix_equals_loops_and_merges():
    rng = np.random.default_rng(0)
    frames = [
        (
            rng.integers(0, 4, (9, 11)).astype(np.uint8),
            rng.choice([0, 1, 2, 3, 255], (9, 11)).astype(np.uint8),
        )
        for _ in range(3)
    ]
    expected = np.zeros((4, 4), dtype=np.int64)
    for prediction, semantic in frames:
        for v, u in np.ndindex(9, 11):
            if semantic[v, u] != 255:
                expected[semantic[v, u], prediction[v, u]] += 1
    first, second = SemanticScores(4), SemanticScores(4)
    first.update(*frames[0])
    for frame in frames[1:]:
        second.update(*frame)
    first.merge(second)
    np.testing.assert_array_equal(first.confusion, expected)


def test_depth_metrics_by_hand():
    scores = DepthScores()
    scores.update(
        np.array([[12.0, 19.0, 44.0, 90.0, 5.0, 5.0, 5.0, 5.0]], dtype=np.float32),
        np.array([[10.0, 20.0, 40.0, 80.0, 0.0, np.nan, 100.5, np.inf]], dtype=np.float32),
    )
    metrics = scores.compute()  # errors 2, 1, 4, 10
    assert metrics.ranges == {
        (0, 20): Errors(2, pytest.approx(1.5), pytest.approx(math.sqrt(5 / 2))),
        (0, 50): Errors(3, pytest.approx(7 / 3), pytest.approx(math.sqrt(21 / 3))),
        (0, 10): Errors(1, 2, 2),
        (10, 20): Errors(1, 1, 1),
        (20, 40): Errors(1, 4, 4),
        (40, 100): Errors(1, 10, 10),
    }
    assert (metrics.metres.pixels, metrics.metres.mae) == (4, pytest.approx(17 / 4))
    assert metrics.metres.rmse == pytest.approx(math.sqrt(121 / 4))
    inverse = [1000 / 10 - 1000 / 12, 1000 / 19 - 1000 / 20, 1000 / 40 - 1000 / 44, 12.5 - 100 / 9]
    assert metrics.per_km.mae == pytest.approx(sum(inverse) / 4)
    assert metrics.per_km.rmse == pytest.approx(math.sqrt(sum(x * x for x in inverse) / 4))


def test_the_median_is_of_all_frames_together():
    rng = np.random.default_rng(0)
    depth = rng.uniform(5, 80, (2, 30, 40))
    prediction = depth + rng.normal(0, 1.0, depth.shape) * rng.choice([0.01, 1, 30], depth.shape)
    prediction = np.maximum(prediction, 0.0)
    whole, parts = DepthScores(), [DepthScores(), DepthScores()]
    for index, part in enumerate(parts):
        whole.update(prediction[index], depth[index])
        part.update(prediction[index], depth[index])
    parts[0].merge(parts[1])
    expected = np.median(np.abs(prediction - depth))
    assert whole.compute().median_m == pytest.approx(expected, rel=0.01)
    assert parts[0].compute().median_m == whole.compute().median_m
    exact = DepthScores()
    exact.update(depth[0], depth[0])
    assert (exact.compute().median_m, exact.compute().metres.mae) == (0, 0)
    assert math.isnan(DepthScores().compute().median_m)


def test_depth_scores_accumulate_over_pixels_not_frames():
    rng = np.random.default_rng(1)
    frames = [(1 + 99 * rng.random((4, n)), 1 + 99 * rng.random((4, n))) for n in (3, 8, 20)]
    merged = DepthScores()
    for prediction, depth in frames:
        one = DepthScores()
        one.update(prediction, depth)
        merged.merge(one)
    error = np.concatenate([(prediction - depth).ravel() for prediction, depth in frames])
    assert merged.compute().metres.mae == pytest.approx(np.abs(error).mean())
    assert merged.compute().metres.rmse == pytest.approx(np.sqrt((error**2).mean()))
    inverse = np.concatenate(
        [(1e3 / prediction - 1e3 / depth).ravel() for prediction, depth in frames]
    )
    assert merged.compute().per_km.mae == pytest.approx(np.abs(inverse).mean())
    assert merged.compute().per_km.rmse == pytest.approx(np.sqrt((inverse**2).mean()))


def test_no_answer_is_scored_and_nan_is_refused():
    scores = DepthScores()
    scores.update(np.zeros((1, 1)), np.full((1, 1), 10.0))
    metrics = scores.compute()
    assert metrics.metres.mae == 10.0
    assert metrics.per_km.mae == pytest.approx(1000 / 0.1 - 1000 / 10)
    assert math.isnan(DepthScores().compute().metres.mae)


def two_halves(edge, size=(6, 12)):
    """A label map that changes at one column, which is its boundary."""
    semantic = np.zeros(size, dtype=np.uint8)
    semantic[:, edge:] = 1
    return semantic


def boundary_by_loops(probability, semantic, threshold, tolerance):
    height, width = semantic.shape
    true, unknown = set(), set()
    for v, u in np.ndindex(height, width):
        before = [semantic[v, u - 1]] * (u > 0) + [semantic[v - 1, u]] * (v > 0)
        here = semantic[v, u]
        if here == 255:
            unknown.add((v, u))
        elif any(other not in (255, here) for other in before):
            true.add((v, u))
        elif 255 in before:
            unknown.add((v, u))
    predicted = {
        (v, u)
        for v, u in np.ndindex(height, width)
        if probability[v, u] > threshold and (v, u) not in unknown
    }

    def share_near(these, those):
        near = [any(math.dist(a, b) <= tolerance for b in those) for a in these]
        return sum(near) / len(near)

    return share_near(predicted, true), share_near(true, predicted)


def test_boundary_scores_equal_loops():
    rng = np.random.default_rng(2)
    semantic = rng.choice([0, 1, 255], (5, 7)).repeat(3, axis=0).repeat(3, axis=1)
    probability = rng.random(semantic.shape) ** 6
    scores = BoundaryScores()
    scores.update(probability, semantic)
    metrics = scores.compute(0.4)
    expected = boundary_by_loops(probability, semantic, 0.4, 2)
    assert (metrics.precision, metrics.recall) == pytest.approx(expected)
    assert 0 < metrics.precision < 1
    assert 0 < metrics.recall < 1


def test_best_threshold_over_the_set_and_merge():
    truth = two_halves(4)
    probability = np.full((6, 12), 0.38, dtype=np.float32)
    probability[:, 4] = 0.8
    total = BoundaryScores()
    for _ in range(2):
        one = BoundaryScores()
        one.update(probability, truth)
        total.merge(one)
    assert total.compute().threshold == 0.4  # the first of equal ones
    assert total.compute().f_score == 1.0


def test_categories_join_their_classes():
    names = ("road", "sidewalk", "car", "misc")
    groups = {"flat": {"road", "sidewalk"}, "vehicle": {"car"}, "sky": {"sky"}}
    scores = SemanticScores(4)
    truth = np.array([[0, 0, 1, 1, 2, 2, 3, 255]])
    answer = np.array([[1, 0, 0, 2, 2, 3, 2, 0]])
    scores.update(answer, truth)
    # Flat: 3 of 4 right, road for sidewalk is no mistake; nothing else is called flat. Car: one
    # right, one called misc, one sidewalk called car; misc labelled does not count.
    assert scores.compute_categories(names, groups) == {
        "flat": pytest.approx(3 / 4),
        "vehicle": pytest.approx(1 / 3),
    }
    assert scores.compute_categories(("a", "b", "c", "d"), groups) == {}


def test_disparity_errors_equal_the_hand_computed_ones():
    depth = np.array([[10.0, 20.0, 0.0, 40.0, 100.5]])
    answer = np.array([[20.0, 20.0, 5.0, 0.0, 5.0]])
    scores = DisparityScores()
    scores.update(answer[:, :2], depth[:, :2], 400.0)
    other = DisparityScores()
    other.update(answer[:, 2:], depth[:, 2:], 400.0)
    scores.merge(other)
    metrics = scores.compute()
    # 400 / 10 - 400 / 20 = 20 px; 0; unknown; 0 m is taken as 0.1 m: 4000 - 10 px; too far.
    assert metrics.pixels == 3
    assert metrics.mae == pytest.approx((20 + 0 + 3990) / 3)
    assert metrics.rmse == pytest.approx(math.sqrt((20**2 + 3990**2) / 3))
    assert math.isnan(DisparityScores().compute().mae)


def test_road_iou_by_hand():
    scores, other = RoadScores(4), RoadScores(4)
    mask = np.array([[1, 1, 1, 0, 0, 0, 255, 255]], np.uint8)
    ids = np.array([[3, 3, 2, 3, 0, 1, 3, 0]], np.uint8)
    scores.update(ids, mask)
    assert scores.compute(road=3) == pytest.approx(2 / 4)  # 2 hit of 3, one more predicted
    assert scores.compute(road=2) == pytest.approx(1 / 3)
    other.update(np.full_like(ids, 3), mask)
    scores.merge(other)
    assert scores.compute(road=3) == pytest.approx(5 / 10)
    assert math.isnan(RoadScores(4).compute(road=3))
