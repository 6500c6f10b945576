"""From what comes out of the network to the answers for a frame: check, resize."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.prediction import (
    BOUNDARY_NOT_FINITE,
    DEPTH_NOT_FINITE,
    LOGITS_NOT_FINITE,
    SEMANTIC_UNKNOWN_CLASS,
)
from runtime.preprocess import NetworkInput
from runtime.resize import resize_answer

_FLOAT_HEADS = {
    "depth": DEPTH_NOT_FINITE,
    "boundary": BOUNDARY_NOT_FINITE,
    "semantic_logits": LOGITS_NOT_FINITE,
}


@dataclass(frozen=True, eq=False)
class Answers:
    """What a frame's prediction says.

    heads: head -> array at the frame's size
    faults: reasons why they cannot be used; () if they can
    """

    heads: Mapping[str, NDArray[Any]]
    faults: tuple[str, ...]


def postprocess(
    outputs: Mapping[str, NDArray[Any]], frame: NetworkInput, *, num_classes: int
) -> Answers:
    """Check the outputs of one frame, head -> array, and bring them to the frame's size."""
    found = faults(outputs, num_classes=num_classes)
    if frame.network_size != frame.frame_size:
        outputs = {
            head: resize_answer(head, values, frame.frame_size) for head, values in outputs.items()
        }
    return Answers(outputs, found)


def faults(outputs: Mapping[str, NDArray[Any]], *, num_classes: int) -> tuple[str, ...]:
    """The reasons why these outputs cannot be used; () if they can.

    outputs: head -> array of one frame.
    """
    found = [
        reason
        for head, reason in _FLOAT_HEADS.items()
        if head in outputs and not _all_finite(outputs[head])
    ]
    if "semantic" in outputs and int(outputs["semantic"].max()) >= num_classes:
        found.append(SEMANTIC_UNKNOWN_CLASS)
    return tuple(found)


def _all_finite(values: NDArray[Any]) -> bool:
    # NaN and Inf reach the minimum or the maximum: half the time of np.isfinite(values).all().
    return bool(np.isfinite(values.min()) and np.isfinite(values.max()))
