"""Regions of a frame by the distance of a pixel to the nearest return that was fed.

Distances are Euclidean between the centres of pixels, at the size of the frame.
"""

import math
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

# Largest distance [px] of each region.
RETURN_DISTANCES: Mapping[str, float] = {
    "return_0_px": 0,
    "return_1_2_px": 2,
    "return_3_6_px": 6,
    "return_over_6_px": math.inf,
}


def split_distances(to_return_px: NDArray[np.float32]) -> dict[str, NDArray[np.bool_]]:
    """Return the mask, bool (H, W), of each of `RETURN_DISTANCES`; they do not overlap.

    `to_return_px`, (H, W), is the distance to the nearest return that was fed.
    """
    masks, above = {}, -1.0
    for region, limit in RETURN_DISTANCES.items():
        masks[region] = (to_return_px > above) & (to_return_px <= limit)
        above = limit
    return masks


def distance_px(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of every pixel to the nearest of the mask; infinite if it is empty."""
    if not mask.any():  # OpenCV's distance would be finite
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(
        cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    )
