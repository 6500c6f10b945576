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


def test_a_float_file_repeats_its_answers_as_exactly_as_pytorchs(contract):
    for head in HEADS:
        limits = reference_limits(head, contract, from_torch=False)
        assert limits == file_limits(head, contract)


EXACT = {"semantic": {"agreement": 1.0}, "depth": {"max_abs_m": 0.0, "mean_relative": 0.0}}
MEASURED = {"semantic": {"agreement": 0.9}, "depth": {"max_abs_m": 90.0, "mean_relative": 0.1}}
OF_8_BITS = {
    "semantic": {"agreement": 0.96}, "depth": {"mean_relative": 0.025},
    "boundary": {"mean_abs": 0.02}, "depth_uncertainty": {"mean_relative": 0.1},
}  # fmt: skip


@pytest.mark.parametrize(("precision", "parity", "from_torch", "expected"), [
    ("fp16", {}, False, {"depth": {"max_abs_m": 0.4}, "semantic": {"agreement": 0.995},
                         "boundary": {"mean_abs": 0.02}}),
    ("int8", MEASURED, False, OF_8_BITS), ("int8", {}, False, OF_8_BITS),
    # Answers of PyTorch: means, beside the difference that was measured at export.
    ("int8", MEASURED, True, {"semantic": {"agreement": 0.86}, "depth": {"mean_relative": 0.125}}),
    ("int8", EXACT, True, {"semantic": {"agreement": 0.96}, "depth": {"mean_relative": 0.025}}),
    ("fp32", EXACT, True, {"semantic": {"agreement": 0.9995}, "depth": {"mean_relative": 5e-5}}),
    ("fp16", EXACT, True, {"depth": {"mean_relative": 0.005}}),
])  # fmt: skip
def test_limits_by_precision_and_origin(contract, precision, parity, from_torch, expected):
    file = replace(contract, max_depth_m=80.0, precision=precision, parity=parity)
    for head, limits in expected.items():
        found = reference_limits(head, file, from_torch=from_torch)
        assert found == pytest.approx(limits), head
