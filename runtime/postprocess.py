"""From what comes out of the network to the answers for a frame: check, convert, resize."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.contract import NO_CLASS, Contract
from runtime.errors import InferenceError
from runtime.heads import HEADS, Head, Unit
from runtime.preprocess import NetworkInput
from runtime.resize import resize_answer

_ROUNDING = 1e-3  # of a head's range: how far arithmetic may leave it


def check_outputs(
    outputs: Mapping[str, NDArray[Any]], *, frames: int, size: tuple[int, int], num_classes: int
) -> None:
    """Raise InferenceError unless each output, head -> array, has the shape for these frames."""
    for head, values in outputs.items():
        expected = (frames, *((num_classes,) if HEADS[head].per_class else ()), *size)
        if values.shape != expected:
            raise InferenceError(
                f"the model gave {head} of the shape {values.shape}, expected {expected}: "
                "export it again with ssdnet-export"
            )


def to_frame(outputs: Mapping[str, NDArray[Any]], frame: NetworkInput) -> dict[str, NDArray[Any]]:
    """Convert a frame's outputs, head -> array, to metres and to the frame's size, in place."""
    answers = dict(outputs)
    if frame.scale.factor != 1:
        for head, values in answers.items():
            if HEADS[head].unit is Unit.METRES:
                values *= np.float32(1 / frame.scale.factor)
    if frame.network_size != frame.frame_size:
        for head, values in answers.items():
            answers[head] = resize_answer(head, values, frame.frame_size)
    return answers


def faults(outputs: Mapping[str, NDArray[Any]], contract: Contract) -> tuple[str, ...]:
    """Return the reasons why outputs, head -> array of one frame, cannot be used; () if they can.

    They are "HEAD_not_finite", "HEAD_out_of_range" and, for class ids, "HEAD_unknown_class".
    """
    found = (_fault(HEADS[head], values, contract) for head, values in outputs.items())
    return tuple(fault for fault in found if fault)


def _fault(head: Head, values: NDArray[Any], contract: Contract) -> str:
    low, high = values.min(), values.max()  # NaN and Inf propagate to them
    if head.unit is Unit.CLASS_ID:
        if high == NO_CLASS:
            return f"{head.name}_not_finite"
        return "" if high < len(contract.classes) else f"{head.name}_unknown_class"
    if not (np.isfinite(low) and np.isfinite(high)):
        return f"{head.name}_not_finite"
    least, most = head.bounds(contract.max_depth_m)
    margin = _ROUNDING * (most - least) if np.isfinite(most - least) else 0.0
    return "" if least - margin <= low and high <= most + margin else f"{head.name}_out_of_range"
