"""From what comes out of the network to the answers for a frame: check, resize."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.contract import NO_CLASS, Contract
from runtime.prediction import (
    BOUNDARY_NOT_FINITE,
    BOUNDARY_OUT_OF_RANGE,
    DEPTH_NOT_FINITE,
    DEPTH_OUT_OF_RANGE,
    DEPTH_UNCERTAINTY_NOT_FINITE,
    DEPTH_UNCERTAINTY_OUT_OF_RANGE,
    LOGITS_NOT_FINITE,
    SEMANTIC_NOT_FINITE,
    SEMANTIC_UNKNOWN_CLASS,
)
from runtime.preprocess import NetworkInput
from runtime.resize import resize_answer

_IN_METRES = frozenset({"depth", "depth_uncertainty"})
_ROUNDING = 1e-3  # of the range: how far arithmetic may leave it


@dataclass(frozen=True, eq=False)
class Answers:
    """What a frame's prediction says.

    heads: head -> array at the frame's size
    faults: reasons why they cannot be used; () if they can
    """

    heads: Mapping[str, NDArray[Any]]
    faults: tuple[str, ...]


def postprocess(
    outputs: Mapping[str, NDArray[Any]], frame: NetworkInput, contract: Contract
) -> Answers:
    """Check the outputs of one frame, head -> array, and bring them to its metres and its size."""
    found = faults(outputs, contract)
    if frame.depth_factor != 1:
        for head in _IN_METRES & outputs.keys():
            outputs[head][...] *= np.float32(1 / frame.depth_factor)  # the session's, now ours
    if frame.network_size != frame.frame_size:
        outputs = {
            head: resize_answer(head, values, frame.frame_size) for head, values in outputs.items()
        }
    return Answers(outputs, found)


def faults(outputs: Mapping[str, NDArray[Any]], contract: Contract) -> tuple[str, ...]:
    """The reasons why these outputs cannot be used; () if they can.

    outputs: head -> array of one frame, not empty.
    """
    found = []
    if "depth" in outputs:
        limit = contract.max_depth_m
        found += _range_faults(outputs["depth"], limit, DEPTH_NOT_FINITE, DEPTH_OUT_OF_RANGE)
    if "depth_uncertainty" in outputs:
        scale = outputs["depth_uncertainty"]
        if not _all_finite(scale):
            found.append(DEPTH_UNCERTAINTY_NOT_FINITE)
        elif scale.min() < 0:
            found.append(DEPTH_UNCERTAINTY_OUT_OF_RANGE)
    if "boundary" in outputs:
        found += _range_faults(outputs["boundary"], 1.0, BOUNDARY_NOT_FINITE, BOUNDARY_OUT_OF_RANGE)
    if "semantic_logits" in outputs and not _all_finite(outputs["semantic_logits"]):
        found.append(LOGITS_NOT_FINITE)
    if "semantic" in outputs:
        highest = int(outputs["semantic"].max())
        if highest == NO_CLASS:
            found.append(SEMANTIC_NOT_FINITE)
        elif highest >= len(contract.classes):
            found.append(SEMANTIC_UNKNOWN_CLASS)
    return tuple(found)


def _range_faults(
    values: NDArray[Any], limit: float, not_finite: str, out_of_range: str
) -> list[str]:
    """What is wrong with values that must lie in 0..limit, but for rounding."""
    low, high = values.min(), values.max()  # NaN and Inf reach one of them
    if not (np.isfinite(low) and np.isfinite(high)):
        return [not_finite]
    margin = _ROUNDING * limit
    return [] if low >= -margin and high <= limit + margin else [out_of_range]


def _all_finite(values: NDArray[Any]) -> bool:
    # NaN and Inf reach the minimum or the maximum: half the time of np.isfinite(values).all().
    return bool(np.isfinite(values.min()) and np.isfinite(values.max()))
