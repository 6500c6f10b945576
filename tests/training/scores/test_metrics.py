"""Table 1's metrics against plain loops and cases by hand."""

import math

import numpy as np
import pytest

from training.scores.metrics import (
    RETURN_DISTANCES,
    BoundaryScores,
    DepthErrors,
    DepthScores,
    RoadScores,
    SemanticScores,
    distance_px,
    split_distances,
)


def test_semantic_metrics_by_hand():
    scores = SemanticScores(5)
    scores.update(
        np.array([[0, 0, 0, 1, 1, 3, 2, 0]], dtype=np.uint8),
        np.array([[0, 0, 0, 0, 1, 1, 2, 255]], dtype=np.uint8),
    )
    figures = scores.figures("abcde")
    # IoU: 3/4, 1/3, 1/1, 0/1 (class 3 only predicted); class 4 is nowhere and left out.
    assert [figures[f"iou_{name}"] for name in "abcd"] == pytest.approx([3 / 4, 1 / 3, 1, 0])
    assert math.isnan(figures["iou_e"])
    assert figures["miou"] == pytest.approx((3 / 4 + 1 / 3 + 1) / 4)
    assert figures["accuracy"] == pytest.approx(5 / 7)
    assert figures["mean_accuracy"] == pytest.approx((3 / 4 + 1 / 2 + 1) / 3)
    assert figures["fwiou"] == pytest.approx((4 * 3 / 4 + 2 / 3 + 1) / 7)
    assert scores.frames.tolist() == [1, 1, 1, 0, 0]
    assert scores.unscored.tolist() == [1, 8]
    assert SemanticScores(5).figures("abcde") == {}
    # A foreign class, 5, is a wrong answer, and no class of its own.
    scores.update(np.full((1, 5), 5, np.uint8), np.full((1, 5), 2, np.uint8))
    assert scores.figures("abcde")["iou_c"] == pytest.approx(1 / 6)


def test_confusion_matrix_equals_loops_and_merges():
    rng = np.random.default_rng(0)
    frames = [
        (
            rng.integers(0, 5, (9, 11)).astype(np.uint8),
            rng.choice([0, 1, 2, 3, 255], (9, 11)).astype(np.uint8),
        )
        for _ in range(3)
    ]
    expected = np.zeros((4, 5), dtype=np.int64)
    first, second = SemanticScores(4), SemanticScores(4)
    for scores, (prediction, semantic) in zip((first, second, second), frames, strict=True):
        scores.update(prediction, semantic)
        for v, u in np.ndindex(9, 11):
            if semantic[v, u] != 255:
                expected[semantic[v, u], prediction[v, u]] += 1
    first.merge(second)
    np.testing.assert_array_equal(first.confusion, expected)


def test_categories_join_their_classes():
    others = ["building", "pole", "tree", "sky", "person"]  # of the other categories, not seen
    scores = SemanticScores(9)
    truth = np.array([[0, 0, 1, 1, 2, 2, 3, 255]])
    scores.update(np.array([[1, 0, 0, 2, 2, 3, 2, 0]]), truth)
    names = ["road", "sidewalk", "car", "misc", *others]
    figures = {name: value for name, value in scores.figures(names).items() if value == value}
    # Flat: 3 of 4 right, road for sidewalk is no mistake; nothing else is called flat. Car: one
    # right, one called misc, one sidewalk called car; misc labelled does not count.
    assert {name: value for name, value in figures.items() if "category" in name} == {
        "category_miou": pytest.approx((3 / 4 + 1 / 3) / 2),
        "category_iou_flat": pytest.approx(3 / 4),
        "category_iou_vehicle": pytest.approx(1 / 3),
    }
    without_sky = scores.figures([*names[:-2], "heaven", "person"])
    assert not any("category" in name for name in without_sky)


def test_road_iou_by_hand():
    scores, other = RoadScores(4), RoadScores(4)
    mask = np.array([[1, 1, 1, 0, 0, 0, 255, 255]], np.uint8)
    ids = np.array([[3, 3, 2, 3, 0, 1, 3, 0]], np.uint8)
    scores.update(ids, mask)
    # Of 3 pixels 2 are hit, and one more is predicted.
    assert scores.figures(["a", "b", "c", "Road"]) == {"road_iou": pytest.approx(2 / 4)}
    assert scores.figures(["a", "b", "road", "d"]) == {"road_iou": pytest.approx(1 / 3)}
    assert scores.figures("abcd") == RoadScores(4).figures(["road", *"bcd"]) == {}
    other.update(np.full_like(ids, 3), mask)
    scores.merge(other)
    assert scores.figures([*"abc", "road"])["road_iou"] == pytest.approx(5 / 10)


def test_depth_metrics_by_hand():
    scores = DepthScores()
    answer = np.array([[12.0, 19.0, 44.0, 90.0, 5.0, 5.0, 5.0, 5.0]], dtype=np.float32)
    truth = np.array([[10.0, 20.0, 40.0, 80.0, 0.0, np.nan, 100.5, np.inf]], dtype=np.float32)
    scores.update(DepthErrors(answer, truth))
    inverse = [1000 / 10 - 1000 / 12, 1000 / 19 - 1000 / 20, 1000 / 40 - 1000 / 44, 12.5 - 100 / 9]
    figures = scores.figures()  # errors 2, 1, 4, 10
    assert 2 * 0.997 < figures.pop("median_m") < 2 * 1.003  # the lower middle
    assert figures == pytest.approx(
        {
            "mae_m": 17 / 4,
            "rmse_m": math.sqrt(121 / 4),
            "mae_m_0_20": 1.5,
            "rmse_m_0_20": math.sqrt(5 / 2),
            "mae_m_0_50": 7 / 3,
            "rmse_m_0_50": math.sqrt(21 / 3),
            **{f"{error}_m_0_10": 2 for error in ("mae", "rmse")},
            **{f"{error}_m_10_20": 1 for error in ("mae", "rmse")},
            **{f"{error}_m_20_40": 4 for error in ("mae", "rmse")},
            **{f"{error}_m_40_100": 10 for error in ("mae", "rmse")},
            "imae_per_km": sum(inverse) / 4,
            "irmse_per_km": math.sqrt(sum(x * x for x in inverse) / 4),
        }
    )
    assert scores.unscored.tolist() == [2, 6]
    farther = DepthScores(farthest_m=400.0)
    answer, truth = np.array([[5.0, 300.0, 5.0]]), np.array([[10.0, 290.0, 401.0]])
    farther.update(DepthErrors(answer, truth, 400.0))
    figures = farther.figures()
    assert (figures["mae_m"], figures["mae_m_100_400"]) == (7.5, 10.0)
    assert DepthScores().figures() == {}


def test_depth_is_scored_over_the_pixels_of_all_frames_together():
    rng = np.random.default_rng(0)
    depth = [rng.uniform(5, 80, (4, count)) for count in (30, 80, 200)]
    answers = [d + rng.normal(0, 1, d.shape) * rng.choice([0.01, 1, 30], d.shape) for d in depth]
    merged = DepthScores()
    for answer, truth in zip(answers, depth, strict=True):
        one = DepthScores()
        one.update(DepthErrors(answer, truth))
        merged.merge(one)
    error = np.abs(np.concatenate(answers, axis=1) - np.concatenate(depth, axis=1))
    figures = merged.figures()
    assert figures["mae_m"] == pytest.approx(error.mean())
    assert figures["rmse_m"] == pytest.approx(np.sqrt((error**2).mean()))
    assert figures["median_m"] == pytest.approx(np.median(error), rel=0.01)


def test_disparity_errors_equal_the_hand_computed_ones():
    depth = np.array([[10.0, 20.0, 0.0, 40.0, 100.5]])
    answer = np.array([[20.0, 20.0, 5.0, 0.0, 5.0]])
    scores, other = DepthScores(), DepthScores()
    scores.update(DepthErrors(answer[:, :2], depth[:, :2]), 400.0)
    other.update(DepthErrors(answer[:, 2:], depth[:, 2:]), 400.0)
    scores.merge(other)
    # 400 / 10 - 400 / 20 = 20 px; 0; unknown; 0 m is taken as 0.1 m: 4000 - 10 px; too far.
    assert scores.sums[0] == 3
    figures = scores.figures()
    assert figures["mae_px"] == pytest.approx((20 + 0 + 3990) / 3)
    assert figures["rmse_px"] == pytest.approx(math.sqrt((20**2 + 3990**2) / 3))


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


@pytest.mark.parametrize("threshold", [0.4, 0.85])
def test_boundary_scores_equal_loops(threshold):
    rng = np.random.default_rng(2)
    semantic = rng.choice([0, 1, 255], (5, 7)).repeat(3, axis=0).repeat(3, axis=1)
    probability = rng.random(semantic.shape) ** 6
    scores = BoundaryScores()
    scores.update(probability, semantic)
    figures = scores.figures(threshold)
    precision, recall = boundary_by_loops(probability, semantic, threshold, 2)
    assert 0 < recall < 1
    assert figures == pytest.approx(
        {
            "boundary_f": 2 * precision * recall / (precision + recall),
            "boundary_precision": precision,
            "boundary_recall": recall,
            "boundary_threshold": threshold,
        }
    )


def test_best_threshold_over_the_set_and_merge():
    truth = np.zeros((6, 12), np.uint8)
    truth[:, 4:] = 1
    probability = np.full((6, 12), 0.38, dtype=np.float32)
    probability[:, 4] = 0.8
    total = BoundaryScores()
    for _ in range(2):
        one = BoundaryScores()
        one.update(probability, truth)
        total.merge(one)
    figures = total.figures()
    assert figures["boundary_threshold"] == 0.4  # the first of equal ones
    assert figures["boundary_f"] == 1.0
    nothing = BoundaryScores()
    nothing.update(0 * probability, truth)
    assert nothing.figures()["boundary_f"] == 0
    assert math.isnan(nothing.figures()["boundary_precision"])
    assert BoundaryScores().figures() == {}


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
