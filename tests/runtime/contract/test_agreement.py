"""Figures and limits of each head, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from runtime.contract.agreement import (
    compare,
    figure_name,
    file_limits,
    reference_limits,
    within,
    worst,
)
from runtime.contract.heads import HEADS


@pytest.mark.parametrize(("head", "answer", "expected", "figures"), [
    ("semantic", [[1, 2], [3, 4]], [[1, 2], [3, 5]], {"agreement": 0.75}),
    *((head, [[1, 2], [3, 4]], [[1, 2.5], [3, 3]],
       {"max_abs_m": 1.0, "mean_abs_m": 0.375, "mean_relative": 0.375 / 2.375})
      for head in ("depth", "depth_uncertainty")),
    ("semantic_logits", [[[1, -3]]], [[[1, -4]]], {"max_relative": 0.25, "mean_relative": 0.2}),
])  # fmt: skip
def test_the_figures_of_a_head(head, answer, expected, figures):
    dtype = np.uint8 if head == "semantic" else np.float32
    assert compare(head, np.array(answer, dtype), np.array(expected, dtype)) == figures


@pytest.mark.parametrize(("head", "short", "name"), [
    ("semantic", "equal", "agreement"), ("depth", "mean", "mean_abs_m"),
    ("depth", "p99", "p99_abs_m"), ("boundary", "max", "max_abs"),
    ("boundary", "p99.9", "p99.9_abs"),
    ("semantic_logits", "p50", "p50_relative"), ("semantic_logits", "mean", "mean_relative"),
])  # fmt: skip
def test_each_figure_that_a_person_names_is_one_that_is_compared(head, short, name):
    assert figure_name(head, short) == name
    answer = np.ones((2, 2), np.uint8 if head == "semantic" else np.float32)
    assert name in compare(head, answer, answer, [name])


def test_a_percentile_is_that_of_the_difference():
    answer = np.arange(101, dtype=np.float32)[None]
    assert compare("depth", answer, np.zeros_like(answer), ["p25_abs_m"])["p25_abs_m"] == 25
    assert compare("semantic_logits", 2 * answer, answer, ["p25_relative"])["p25_relative"] == 0.25


@pytest.mark.parametrize(("head", "short"), [
    ("semantic", "mean"), ("semantic", ""), ("depth", "equal"), ("depth", "p101"), ("depth", "p"),
    ("depth", "mean_abs_m"),
])  # fmt: skip
def test_a_figure_that_the_head_lacks_is_refused_with_those_it_has(head, short):
    with pytest.raises(ValueError, match=f"give {head}."):
        figure_name(head, short)


def test_of_boundaries_the_mean_counts(contract):
    """A class that rounding changes moves a few pixels far."""
    answer, expected = np.zeros((20, 50), np.float32), np.zeros((20, 50), np.float32)
    answer[0, :3] = 0.5
    figures = compare("boundary", answer, expected)
    assert figures == {"mean_abs": 0.0015, "max_abs": 0.5}
    assert within(figures, file_limits("boundary", contract))
    answer[0, :5] = 0.5
    assert not within(compare("boundary", answer, expected), file_limits("boundary", contract))


def test_the_worst_is_the_least_agreement_and_the_largest_difference():
    assert worst([{"agreement": 0.9}, {"agreement": 0.8}]) == {"agreement": 0.8}
    figures = [{"max_abs_m": 1.0, "mean_abs_m": 0.5}, {"max_abs_m": 0.5, "mean_abs_m": 0.7}]
    assert worst(figures) == {"max_abs_m": 1.0, "mean_abs_m": 0.7}


def test_limits_hold_on_their_side_and_nan_never_does(contract):
    for range_m, limit in ((80.0, 0.004), (100.0, 0.005), (200.0, 0.005)):  # near depth is as exact
        limits = file_limits("depth", replace(contract, max_depth_m=range_m))
        assert limits == {"max_abs_m": pytest.approx(limit)}
    assert within({"max_abs_m": 0.004}, {"max_abs_m": 0.004})
    assert not within({"max_abs_m": 0.0041}, {"max_abs_m": 0.004})
    assert within({"agreement": 0.9995}, file_limits("semantic", contract))
    assert not within({"agreement": 0.9994}, file_limits("semantic", contract))
    nothing = compare("depth", np.float32([[np.nan, 1]]), np.float32([[0, 1]]))
    good = {"max_abs_m": 0.0, "mean_abs_m": 0.0, "mean_relative": 0.0}
    for figure in nothing:
        assert not within(worst([good, nothing]), {figure: 1})


def test_half_precision_has_wider_limits(contract):
    half = replace(contract, max_depth_m=80.0, precision="fp16")
    assert file_limits("depth", half) == {"max_abs_m": pytest.approx(0.4)}
    assert file_limits("semantic", half) == {"agreement": pytest.approx(0.995)}
    assert file_limits("boundary", half) == {"mean_abs": pytest.approx(0.02)}


def test_a_float_file_repeats_its_answers_as_exactly_as_pytorchs(contract):
    for head in HEADS:
        limits = reference_limits(head, contract, from_torch=False)
        assert limits == file_limits(head, contract)


def test_eight_bits_are_limited_by_shares_and_means_whatever_the_parity(contract):
    for parity in ({"semantic": {"agreement": 0.7}, "depth": {"mean_relative": 0.3}}, {}):
        int8 = replace(contract, precision="int8", parity=parity)
        for head, limits in {
            "semantic": {"agreement": 0.96},
            "depth": {"mean_relative": 0.025},
            "boundary": {"mean_abs": 0.02},
            "depth_uncertainty": {"mean_relative": 0.1},
        }.items():
            assert reference_limits(head, int8, from_torch=False) == limits


def test_pytorchs_answers_are_limited_by_means_beside_the_measured_difference(contract):
    measured = {"semantic": {"agreement": 0.9}, "depth": {"max_abs_m": 90.0, "mean_relative": 0.1}}
    exact = {"semantic": {"agreement": 1.0}, "depth": {"max_abs_m": 0.0, "mean_relative": 0.0}}
    for precision, parity, agreement, mean_relative in (
        ("int8", measured, 0.86, 0.125),
        ("int8", exact, 0.96, 0.025),
        ("fp32", exact, 0.9995, 5e-5),
    ):
        file = replace(contract, precision=precision, parity=parity)
        limits = reference_limits("semantic", file, from_torch=True)
        assert limits == {"agreement": pytest.approx(agreement)}
        limits = reference_limits("depth", file, from_torch=True)
        assert limits == {"mean_relative": pytest.approx(mean_relative)}
    half = replace(contract, precision="fp16", parity=exact)
    assert reference_limits("depth", half, from_torch=True) == {
        "mean_relative": pytest.approx(0.005)
    }
