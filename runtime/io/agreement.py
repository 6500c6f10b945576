"""How far apart two answers of a head are, and how far they may be.

One rule for an export (the file against PyTorch) and for a recording (a run against an earlier
one), by the rows of `runtime.heads`. The first of a head's figures is compared with its limit.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.contract import Contract
from runtime.heads import HEADS, Difference, Unit

#: How many times the limits of single precision those of half precision are: of a share of pixels
#: that differ, and of a difference of values.
HALF_SHARE, HALF_VALUE = 10, 100


def compare(head: str, answer: NDArray[Any], expected: NDArray[Any]) -> dict[str, float]:
    """Return how far an answer of one head is from the expected one.

    Args:
        head: name in `HEADS`.
        answer: the array to judge.
        expected: the array it should be, of the same shape.

    Returns:
        By the head's `difference`: {"agreement"}, the share of equal pixels; {"max_relative"};
        {"mean_abs", "max_abs"}; or {"max_abs", "mean_abs"}, with "_m" at the end where the unit is
        metres. A NaN in an array is a NaN in the figures.
    """
    row = HEADS[head]
    if row.difference is Difference.EQUAL_SHARE:
        return {row.difference.value: float((answer == expected).mean())}
    difference = np.abs(answer.astype(np.float64) - expected)
    if row.difference is Difference.RELATIVE:
        return {row.difference.value: float((difference / np.abs(expected).max()).max())}
    if row.difference is Difference.MEAN:
        return {"mean_abs": float(difference.mean()), "max_abs": float(difference.max())}
    unit = "_m" if row.unit is Unit.METRES else ""
    return {f"max_abs{unit}": float(difference.max()), f"mean_abs{unit}": float(difference.mean())}


def worst(head: str, figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the worst of each figure of one head over all frames; NaN if any is."""
    pick = np.min if _larger_is_better(head) else np.max  # both let NaN through
    return {name: float(pick([figure[name] for figure in figures])) for name in figures[0]}


def limit(head: str, contract: Contract) -> float:
    """Return the limit of a head's first figure for a file, in that figure's unit.

    In half precision it is wider. 8-bit integers have no limit but what was measured when the file
    was made (`Contract.parity`), and a quarter more.
    """
    own = HEADS[head].limit(contract.max_depth_m)
    measured = contract.parity.get(head)
    if contract.precision == "int8" and measured:
        first = float(next(iter(measured.values())))
        return 1 - 1.25 * (1 - first) if _larger_is_better(head) else max(own, 1.25 * first)
    if contract.precision == "fp16":
        if HEADS[head].difference is Difference.MEAN:
            return HALF_SHARE * own
        return 1 - HALF_SHARE * (1 - own) if _larger_is_better(head) else HALF_VALUE * own
    return own


def within(head: str, figures: Mapping[str, float], limit: float) -> bool:
    """Return whether a head's figures keep to `limit`; NaN does not."""
    first = next(iter(figures.values()))
    return first >= limit if _larger_is_better(head) else first <= limit


def _larger_is_better(head: str) -> bool:
    return HEADS[head].difference is Difference.EQUAL_SHARE
