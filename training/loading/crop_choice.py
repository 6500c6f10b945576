"""Crops for rare classes: of several random windows the window with most of their pixels."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def choose_crop(
    semantic: NDArray[np.uint8],
    window: tuple[int, int],
    offsets: Sequence[tuple[int, int]],
    classes: Sequence[int],
) -> tuple[int, int]:
    """Return the offset (top, left) whose window has most pixels of the classes.

    Ties keep the first, so that frames without labels are cut at random.

    Args:
        semantic: uint8 (H, W), class ids.
        window: (height, width) [px]; larger than the image, it covers it.
        offsets: the candidates.
        classes: ids of the rare classes.
    """
    if len(offsets) == 1:
        return offsets[0]
    is_rare = np.zeros(256, np.bool_)
    is_rare[list(classes)] = True
    rare = is_rare[semantic]
    height, width = window

    def count(offset: tuple[int, int]) -> int:
        top, left = offset
        return int(rare[max(top, 0) : top + height, max(left, 0) : left + width].sum())

    return max(offsets, key=count)
