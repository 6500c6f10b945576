"""The contract's "bilinear" rule; `runtime.preprocess` and `runtime.postprocess` resize by it."""

from typing import Any

import cv2
from numpy.typing import NDArray

_AREA_FACTOR = 2  # bilinear reads 2 x 2 pixels: it skips some when shrinking by more than this


def resize_bilinear(image: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Resize (H, W) or (H, W, C) to `size` (height, width), half-pixel centres.

    A side that shrinks to less than half takes the mean of the area, so that no pixel is skipped.
    """
    height, width = size
    if image.shape[0] > _AREA_FACTOR * height or image.shape[1] > _AREA_FACTOR * width:
        # OpenCV takes areas only where no side grows: the shrinking sides first.
        smaller = min(width, image.shape[1]), min(height, image.shape[0])
        image = cv2.resize(image, smaller, interpolation=cv2.INTER_AREA)
    if image.shape[:2] != size:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return image
