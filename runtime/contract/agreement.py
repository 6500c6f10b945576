"""Differences between two answers of a head, and their limits.

The export compares a model file with PyTorch, and `ssdnet-verify` compares present answers with
those of a reference. The tolerances are in `runtime.contract.heads`.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.contract.contract import Contract
from runtime.contract.heads import HEADS, Difference, Head, Unit

# Factors by which half precision may differ more than single precision: one for the share of
# pixels that differ, and one for values.
HALF_SHARE, HALF_VALUE = 10, 100

_SHARE = Difference.EQUAL_SHARE.value  # the only figure whose limit is a minimum
# Kind of difference -> a figure that is not sensitive to large differences in single pixels.
_MEANS = {
    Difference.EQUAL_SHARE: _SHARE,
    Difference.MEAN: Difference.MEAN.value,
    Difference.ABSOLUTE: "mean_relative",
    Difference.RELATIVE: "mean_relative",
}
_LEAST_MEAN = 1e-9
_PERCENTILE = re.compile(r"p(100|[0-9]{1,2}(?:\.[0-9]{1,3})?)")
# The precisions of files; the least exact one comes last.
_EXACTNESS = ("fp32", "fp16", "int8")


def compare(
    head: str, answer: NDArray[Any], expected: NDArray[Any], wanted: Collection[str] = ()
) -> dict[str, float]:
    """Return how far an answer of one head is from the expected one.

    Args:
        head: name in `HEADS`.
        answer: the array to judge.
        expected: the array it should be, of the same shape.
        wanted: names of further figures to return, see `figure_name`. Percentiles are computed only
            on demand.

    Returns:
        The figures depend on the head's `difference`: {"agreement"}, the share of equal pixels;
        {"max_relative", "mean_relative"}; {"mean_abs", "max_abs"}; or {"max_abs", "mean_abs",
        "mean_relative"}. "_m" follows "abs" if the unit is metres. "mean_relative" is the mean
        difference as a share of the mean expected value. A NaN in an array gives a NaN in the
        figures.
    """
    row = HEADS[head]
    if row.difference is Difference.EQUAL_SHARE:
        return {row.difference.value: float((answer == expected).mean())}
    difference, size = np.abs(answer.astype(np.float64) - expected), np.abs(expected)
    largest, mean = float(difference.max()), float(difference.mean())
    mean_relative = mean / max(float(size.mean(dtype=np.float64)), _LEAST_MEAN)
    suffix = _suffix(row)
    if row.difference is Difference.RELATIVE:
        difference /= size.max()
        figures = {"max_relative": float(difference.max()), "mean_relative": mean_relative}
    elif row.difference is Difference.MEAN:
        figures = {"mean_abs": mean, "max_abs": largest}
    else:
        figures = {f"max{suffix}": largest, f"mean{suffix}": mean, "mean_relative": mean_relative}
    for name in wanted:
        if name not in figures and (percentile := _PERCENTILE.match(name)):
            figures[name] = float(np.percentile(difference, float(percentile[1])))
    return figures


def limited_figure(head: str) -> str:
    """Return the name of the figure that `Head.tolerance` limits."""
    row = HEADS[head]
    in_metres = row.unit is Unit.METRES and row.difference is Difference.ABSOLUTE
    return f"{row.difference}_m" if in_metres else row.difference.value


def figure_name(head: str, short: str) -> str:
    """Return the full name of a figure from its short name, for example "max" or "p99.9".

    Args:
        head: name in `HEADS`.
        short: "equal", the share of equal pixels, for a head of class ids. For every other head,
            "mean", "max" or a percentile of the absolute difference, in the unit of the head. For
            scores, "max" and percentiles are shares of the largest score, and "mean" is a share of
            the mean score.

    Raises:
        ValueError: if the head has no such figure; the message names the figures it has.
    """
    row = HEADS[head]
    if row.difference is Difference.EQUAL_SHARE:
        if short == "equal":
            return _SHARE
        raise ValueError(f"{head} has no figure {short!r}: give {head}.equal")
    if short in ("mean", "max") or _PERCENTILE.fullmatch(short):
        return f"{short}{_suffix(row)}"
    raise ValueError(
        f"{head} has no figure {short!r}: give {head}.mean, {head}.max or a percentile such as "
        f"{head}.p99"
    )


def _suffix(row: Head) -> str:
    """Return the suffix of the names of a head's figures, except for the share of equal pixels."""
    if row.difference is Difference.RELATIVE:
        return "_relative"
    return "_abs_m" if row.unit is Unit.METRES else "_abs"


def worst(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the worst value of each figure of one head over all frames; NaN if one is NaN."""
    return {
        # np.min and np.max propagate NaN, unlike min and max.
        name: float((np.min if name == _SHARE else np.max)([figure[name] for figure in figures]))
        for name in figures[0]
    }


def file_limits(head: str, contract: Contract) -> dict[str, float]:
    """Return the limits for a file's answers compared with PyTorch's on the machine of the export.

    Only `limited_figure` has a limit. 8-bit files are judged by their accuracy instead, see
    `export.int8`.
    """
    row = HEADS[head]
    return _limit(row, limited_figure(head), row.limit(contract.max_depth_m), contract)


def reference_limits(head: str, contract: Contract, *, from_torch: bool) -> dict[str, float]:
    """Return the limits for a reference that is repeated on another machine or in another version.

    A float file that is compared with its own answers has the limits of `file_limits`. An 8-bit
    file differs strongly in some pixels if operations are reordered, so a mean or the share of
    equal pixels is limited instead of the maximum. If PyTorch gave the recorded answers, the same
    figure is limited, and the difference that was measured at export is added.

    Args:
        head: name in `HEADS`.
        contract: the contract of the file.
        from_torch: whether PyTorch gave the recorded answers, not the file.
    """
    if contract.precision != "int8" and not from_torch:
        return file_limits(head, contract)
    row = HEADS[head]
    name, is_int8 = _MEANS[row.difference], contract.precision == "int8"
    if is_int8 and row.difference is Difference.EQUAL_SHARE:
        tolerance = 1 - row.tolerance_int8
    else:
        tolerance = row.tolerance_int8 if is_int8 else row.tolerance
    measured = contract.parity.get(head, {}).get(name) if from_torch else None
    return _limit(row, name, tolerance, contract, measured)


def less_exact(first: Contract, second: Contract) -> Contract:
    """Return the contract of the less exact file; ties keep the first."""
    return max(first, second, key=lambda each: _EXACTNESS.index(each.precision))


def within(figures: Mapping[str, float], limits: Mapping[str, float]) -> bool:
    """Return whether all figures of a head are within their limits; NaN is not."""
    return all(
        figures[name] >= limit if name == _SHARE else figures[name] <= limit
        for name, limit in limits.items()
    )


def _limit(
    row: Head, name: str, tolerance: float, contract: Contract, measured: float | None = None
) -> dict[str, float]:
    """Return the limit of a figure: its tolerance in the file's precision plus `measured`."""
    share = row.difference is Difference.EQUAL_SHARE
    room = 1 - tolerance if share else tolerance
    if contract.precision == "fp16":
        is_value = row.difference in (Difference.ABSOLUTE, Difference.RELATIVE)
        room *= HALF_VALUE if is_value else HALF_SHARE
    if measured is not None:
        room += 1 - measured if share else measured
    return {name: max(1 - room, 0.0) if share else room}
