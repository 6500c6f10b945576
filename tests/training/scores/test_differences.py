"""Whether two models differ: paired intervals by bootstrap."""

import numpy as np
import pytest

from training.lidar.split import LidarInput
from training.scores.differences import compare
from training.scores.metrics import DepthErrors, DepthScores
from training.scores.score_report import format_differences
from training.scores.score_set import FrameScore, Result, Row, means_over_images


def result(model, errors_m, *, hits=None, groups=None):
    """A model with an error of a pixel at 10 m and right pixels, of ten, for each frame.

    Its head "own" has the same error.
    """
    frames = []
    for index, error in enumerate(errors_m):
        depth = DepthScores()
        depth.update(DepthErrors(np.array([[10.0 + error]]), np.array([[10.0]])))
        hit = 0 if hits is None else hits[index]
        confusion = np.array([[hit, 10 - hit, 0], [0, 5, 0]]) * (hits is not None)
        own = {"own": depth.sums}
        group = "" if groups is None else groups[index]
        frames.append(FrameScore(index, f"frame {index}", group, confusion, depth.sums, own))
    row = Row(model, "torch", "set", "own", "none", len(frames), {})
    return Result(row, (LidarInput(), "none"), None, frames, ("road", "car"))


def test_differences_are_of_the_sums_of_all_frames_and_their_signs_are_judged():
    rng = np.random.default_rng(1)
    base = rng.normal(1, 0.2, 40)
    first = result("a", base, hits=[5] * 40)
    better = result("b", base - 0.1, hits=[8] * 40)
    other = result("c", base + rng.normal(0, 0.1, 40), hits=[5] * 40)
    good, same = compare([first, better, other])
    assert (good.row.model, good.against, good.row.frames, good.groups) == ("b", "a", 40, 0)
    assert good.figures["mae_m"] == pytest.approx((-0.1, -0.1, -0.1))  # of every pair alike
    # Of ten pixels of road and five of car: 8 / 10 and 5 / 7, before 5 / 10 and 5 / 10.
    assert good.figures["miou"].value == pytest.approx((8 / 10 + 5 / 7) / 2 - 1 / 2)
    rmse = np.sqrt(np.square(base - 0.1).mean()) - np.sqrt(np.square(base).mean())
    assert good.figures["rmse_m"].value == pytest.approx(rmse)
    assert good.figures["mean_error_own"] == good.figures["mae_m"]
    assert [good.verdict(key) for key in good.figures] == ["better"] * 4
    assert same.verdict("mae_m") == "not distinguishable on 40 frames"
    (worse,) = compare([better, first])
    assert [worse.verdict(key) for key in worse.figures] == ["worse"] * 4
    text = format_differences([good, same])
    assert "than a" in text
    assert "| -100.0 " in text
    assert "| mean error own | -0.1000 " in text
    assert "not distinguishable on 40 frames" in text


def test_the_interval_holds_the_true_difference_as_often_as_it_says():
    """For 40 pairs of models and 40 frames, 38 are expected, and 33 are still likely."""
    rng, held = np.random.default_rng(2), 0
    for _ in range(40):
        base = rng.normal(1, 0.3, 40).clip(0.01)
        change = rng.normal(0.05, 0.1, 40)
        (found,) = compare([result("a", base), result("b", base + change)])
        _, low, high = found.figures["mae_m"]
        held += low <= 0.05 <= high
    assert 33 <= held <= 40


def test_means_over_images_are_those_of_kittis_server():
    parts = [(4, 8.0, 20.0), (1, 10.0, 100.0), (0, 0.0, 0.0)]  # pixels, |error|, its square
    frames = [
        FrameScore(i, "", "", np.zeros((0, 1)), np.array(part)) for i, part in enumerate(parts)
    ]
    found = means_over_images(frames)
    assert found["mae_m_per_image"] == pytest.approx((2 + 10) / 2)
    assert found["rmse_m_per_image"] == pytest.approx((5**0.5 + 10) / 2)
    assert means_over_images(frames[2:]) == {}


def test_frames_of_one_place_count_as_one():
    """Eight alike frames of each of six places: an interval over frames would be too narrow."""
    rng = np.random.default_rng(3)
    base = np.ones(48)
    change = np.repeat(rng.normal(0.05, 0.1, 6), 8)
    groups = [str(index // 8) for index in range(48)]
    (frames,) = compare([result("a", base), result("b", base + change)])
    (places,) = compare(
        [result("a", base, groups=groups), result("b", base + change, groups=groups)]
    )
    width = {
        name: item.figures["mae_m"][2] - item.figures["mae_m"][1]
        for name, item in (("frames", frames), ("places", places))
    }
    assert width["places"] > 2 * width["frames"]
    assert (places.groups, places.sample) == (6, "48 frames of 6 places")
    few = [str(index // 12) for index in range(48)]  # four places tell no interval
    (alone,) = compare([result("a", base, groups=few), result("b", base + change, groups=few)])
    assert alone.groups == 0


def test_too_few_frames_get_no_verdict_and_heads_that_one_lacks_are_left_out():
    for count, verdict in ((5, "too few frames: 5, at least 6 are needed"), (6, "better")):
        (found,) = compare([result("a", [1.0] * count), result("b", [0.5] * count)])
        assert found.verdict("mae_m") == verdict
    (one,) = compare([result("a", [1.0]), result("b", [0.5])])
    assert one.verdict("mae_m") == "too few frames: 1, at least 6 are needed"
    (both,) = compare([result("a", [1, 2], hits=[5, 5]), result("b", [1, 1])])
    assert set(both.figures) == {"mae_m", "rmse_m", "mean_error_own"}
