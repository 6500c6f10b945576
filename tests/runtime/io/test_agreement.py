"""Figures and limits of each head, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.io.agreement import compare, limit, within, worst


def test_classes_are_counted():
    answer, expected = np.array([[1, 2], [3, 4]], np.uint8), np.array([[1, 2], [3, 5]], np.uint8)
    assert compare("semantic", answer, expected) == {"agreement": 0.75}


@pytest.mark.parametrize(
    ("head", "names"),
    [
        ("depth", ["max_abs_m", "mean_abs_m"]),
        ("depth_uncertainty", ["max_abs_m", "mean_abs_m"]),
    ],
)
def test_differences_are_measured(head, names):
    answer, expected = np.float32([[1, 2], [3, 4]]), np.float32([[1, 2.5], [3, 3]])
    assert compare(head, answer, expected) == dict(zip(names, [1.0, 0.375], strict=True))


def test_of_boundaries_the_mean_counts(contract):
    """A class that rounding changes moves a few pixels far."""
    answer, expected = np.zeros((20, 50), np.float32), np.zeros((20, 50), np.float32)
    answer[0, :3] = 0.5
    figures = compare("boundary", answer, expected)
    assert figures == {"mean_abs": 0.0015, "max_abs": 0.5}
    assert within("boundary", figures, limit("boundary", contract))
    answer[0, :5] = 0.5
    assert not within("boundary", compare("boundary", answer, expected), 2e-3)
    expected[0, 0] = np.nan
    assert not within("boundary", compare("boundary", answer, expected), 1.0)


def test_scores_count_as_a_share_of_the_largest():
    answer, expected = np.float32([[[1.0, -3.0]]]), np.float32([[[1.0, -4.0]]])
    assert compare("semantic_logits", answer, expected) == {"max_relative": 0.25}


def test_the_worst_is_the_least_agreement_and_the_largest_difference():
    assert worst("semantic", [{"agreement": 0.9}, {"agreement": 0.8}]) == {"agreement": 0.8}
    figures = [{"max_abs_m": 1.0, "mean_abs_m": 0.5}, {"max_abs_m": 0.5, "mean_abs_m": 0.7}]
    assert worst("depth", figures) == {"max_abs_m": 1.0, "mean_abs_m": 0.7}


def test_limits_hold_on_their_side_and_nan_never_does(contract):
    contract = replace(contract, max_depth_m=80.0)
    assert limit("depth", contract) == pytest.approx(0.004)
    for range_m in (100.0, 200.0):  # near depth is as exact whatever the range
        assert limit("depth", replace(contract, max_depth_m=range_m)) == pytest.approx(0.005)
    assert within("depth", {"max_abs_m": 0.004}, 0.004)
    assert not within("depth", {"max_abs_m": 0.0041}, 0.004)
    assert within("semantic", {"agreement": 0.9995}, limit("semantic", contract))
    assert not within("semantic", {"agreement": 0.9994}, limit("semantic", contract))
    nothing = compare("depth", np.float32([[np.nan, 1]]), np.float32([[0, 1]]))
    assert not within("depth", worst("depth", [{"max_abs_m": 0.0, "mean_abs_m": 0.0}, nothing]), 1)


def test_a_reduced_precision_has_wider_limits(contract):
    half = replace(contract, max_depth_m=80.0, precision="fp16")
    assert limit("depth", half) == pytest.approx(0.4)
    assert limit("semantic", half) == pytest.approx(0.995)
    assert limit("boundary", half) == pytest.approx(0.02)
    measured = {"semantic": {"agreement": 0.96}, "depth": {"max_abs_m": 8.0, "mean_abs_m": 0.1}}
    int8 = replace(half, precision="int8", parity=measured)
    assert limit("depth", int8) == pytest.approx(10.0)
    assert limit("semantic", int8) == pytest.approx(0.95)
    assert limit("boundary", int8) == limit("boundary", replace(half, precision="fp32"))
