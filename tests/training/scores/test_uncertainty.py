"""Does an uncertainty rank and measure the errors: against sorting, and on true distributions."""

import numpy as np
import pytest

from training.scores.metrics import LAPLACE_COVERAGE, DepthErrors, UncertaintyScores


def frames(rng, count=3):
    """Errors drawn from a Laplace distribution of the scale that is given."""
    for _ in range(count):
        depth = rng.uniform(1, 99, (60, 90)).astype(np.float32)
        depth[:5] = 0
        scale = np.exp(rng.normal(-1, 1, depth.shape)).astype(np.float32)
        yield scale, (depth + rng.laplace(0, scale)).astype(np.float32), depth


def test_the_most_confident_pixels_are_those_of_all_frames_sorted():
    scores, other = UncertaintyScores(), UncertaintyScores()
    scales, errors = [], []
    for index, (scale, prediction, depth) in enumerate(frames(np.random.default_rng(0))):
        (other if index else scores).update(scale, DepthErrors(prediction, depth))
        scales.append(scale[depth > 0])
        errors.append(np.abs(prediction - depth)[depth > 0])
    scores.merge(other)
    by_scale = np.concatenate(errors)[np.argsort(np.concatenate(scales))]
    figures = scores.figures()
    for percent in (50, 80, 100):
        expected = by_scale[: round(percent / 100 * by_scale.size)].mean()
        assert figures[f"mae_m_confident_{percent}"] == pytest.approx(expected, rel=0.01), percent
    assert UncertaintyScores().figures() == {}


def test_coverage_of_a_true_scale_is_that_of_laplace_and_of_others_is_not():
    right, small = UncertaintyScores(), UncertaintyScores()
    for scale, prediction, depth in frames(np.random.default_rng(1)):
        right.update(scale, DepthErrors(prediction, depth))
        small.update(scale / 2, DepthErrors(prediction, depth))
    figures = right.figures()
    assert [figures[f"coverage_{n}"] for n in (1, 2)] == pytest.approx(LAPLACE_COVERAGE, abs=0.01)
    assert small.figures()["coverage_2"] == pytest.approx(LAPLACE_COVERAGE[0], abs=0.01)
