"""How far apart two answers of a head are, and how far they may be.

One rule for an export (the file against PyTorch) and for a recording (a run against an earlier
one). Of a head's figures the first is the one that is held against its limit.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Largest difference of depths, as a share of the depth range: 5 mm at 100 m, the step of a
#: 16-bit depth PNG, a quarter of a LiDAR's noise. Rounding in fp32 comes to about a tenth of it.
DEPTH_TOLERANCE = 5e-5
#: Largest difference of a probability; a tenth of the step of an 8-bit picture.
BOUNDARY_TOLERANCE = 4e-4
#: Largest difference of the logits, as a share of the largest logit of the frame.
LOGITS_TOLERANCE = 1e-4
#: Smallest share of pixels with the same class. Rounding flips a pixel only where two classes tie.
SEMANTIC_AGREEMENT = 0.9995

_IN_METRES = ("depth", "depth_uncertainty")


def compare(head: str, answer: NDArray[Any], expected: NDArray[Any]) -> dict[str, float]:
    """Return how far an answer of one head is from the expected one, of the same shape.

    {"agreement"}: share of equal pixels, of `semantic`; {"max_relative"}: of `semantic_logits`;
    {"max_abs_m", "mean_abs_m"} of metres; {"max_abs", "mean_abs"} of other heads. NaN in any of
    the two is NaN in the figures.
    """
    if head == "semantic":
        return {"agreement": float((answer == expected).mean())}
    difference = np.abs(answer.astype(np.float64) - expected)
    if head == "semantic_logits":
        difference /= np.abs(expected).max()
        return {"max_relative": float(difference.max())}
    unit = "_m" if head in _IN_METRES else ""
    return {f"max_abs{unit}": float(difference.max()), f"mean_abs{unit}": float(difference.mean())}


def worst(head: str, figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the worst of each figure of one head over all frames; NaN if any is."""
    pick = np.min if head == "semantic" else np.max  # both let NaN through
    return {name: float(pick([figure[name] for figure in figures])) for name in figures[0]}


def limit(head: str, *, max_depth_m: float) -> float:
    """Return the limit of a head's first figure: the least one of `semantic`, else the largest."""
    return {
        "semantic": SEMANTIC_AGREEMENT,
        "depth": DEPTH_TOLERANCE * max_depth_m,
        "depth_uncertainty": DEPTH_TOLERANCE * max_depth_m,
        "boundary": BOUNDARY_TOLERANCE,
        "semantic_logits": LOGITS_TOLERANCE,
    }[head]


def within(head: str, figures: Mapping[str, float], limit: float) -> bool:
    """Whether a head's figures keep to `limit`; NaN does not."""
    first = next(iter(figures.values()))
    return first >= limit if head == "semantic" else first <= limit
