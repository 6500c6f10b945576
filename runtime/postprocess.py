"""Check what comes out of the network and bring it to the frame's size."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.prediction import (
    BOUNDARY_NOT_FINITE,
    DEPTH_NOT_FINITE,
    LOGITS_NOT_FINITE,
    SEMANTIC_UNKNOWN_CLASS,
)
from runtime.resize import resize_image, resize_nearest

_FLOAT_HEADS = {
    "depth": DEPTH_NOT_FINITE,
    "boundary": BOUNDARY_NOT_FINITE,
    "semantic_logits": LOGITS_NOT_FINITE,
}
_NEAREST = ("semantic", "depth")  # classes and depths are never mixed; the other heads are


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


def resize_output(head: str, values: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Resize one head, (H, W) or (C, H, W), to `size` (height, width) by the contract's rule."""
    if values.ndim == 3:
        return np.stack([resize_output(head, plane, size) for plane in values])
    return resize_nearest(values, size) if head in _NEAREST else resize_image(values, size)
