"""Classical depth completion, without training: what a network has to beat.

Both take and give metres, 0 = no measurement, so they can stand wherever a network's answer does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
import numpy.typing as npt
from cv2.typing import MatLike
from scipy import ndimage

FloatArray = npt.NDArray[np.float32]
#: Sparse depth to dense depth, float32 (H, W) [m].
Fill = Callable[[FloatArray], FloatArray]

#: Nearer than this is no measurement (the value of Ku et al.).
_MEASURED_M = 0.1


def nearest_fill(sparse_depth: FloatArray) -> FloatArray:
    """Give every pixel the depth of the measured pixel nearest to it: float32 (H, W) [m].

    `sparse_depth` float32 (H, W) [m]; 0, negative and not finite = no measurement. Nearness is
    Euclidean in the image. Without any measurement the answer is 0 everywhere.
    """
    measured = np.isfinite(sparse_depth) & (sparse_depth > 0)
    if not measured.any():
        return np.zeros(sparse_depth.shape, dtype=np.float32)
    rows, columns = ndimage.distance_transform_edt(
        ~measured, return_distances=False, return_indices=True
    )
    filled: FloatArray = sparse_depth[rows, columns].astype(np.float32)
    return filled


def ip_basic(
    sparse_depth: FloatArray, *, max_depth_m: float = 100.0, extrapolate: bool = True
) -> FloatArray:
    """Complete a depth map by morphology alone: float32 (H, W) [m].

    The method of Ku, Harakeh and Waslander, "In Defense of Classical Image Processing: Fast Depth
    Completion on the CPU" (CRV 2018), with its kernels for KITTI's 64 lines. Depth is inverted
    first, so that dilation (a local maximum) lets near surfaces win over far ones.

    `sparse_depth` float32 (H, W) [m]; not finite, nearer than 0.1 m or not nearer than
    `max_depth_m` = no measurement. With `extrapolate` every column is continued upwards from its
    topmost value and large holes are filled; then the answer is dense wherever a measurement is
    within reach of the kernels, else 0 = still unknown. Without any measurement it is all 0.
    """
    measured = np.isfinite(sparse_depth) & (sparse_depth > _MEASURED_M)
    measured &= sparse_depth < max_depth_m
    if not measured.any():
        return np.zeros(sparse_depth.shape, dtype=np.float32)
    start = np.where(measured, max_depth_m - sparse_depth, 0.0).astype(np.float32)

    inverted = cv2.dilate(start, _diamond(5))
    inverted = cv2.morphologyEx(inverted, cv2.MORPH_CLOSE, _full(5))
    inverted = _fill_empty(inverted, _full(7))
    if extrapolate:
        inverted = _fill_empty(_extend_to_top(inverted), _full(31))

    # The median removes single outliers; the Gaussian smooths surfaces. As published it takes the
    # zeros of unknown pixels with it, so the outermost two known pixels come out too far.
    inverted = cv2.medianBlur(inverted, 5)
    known = inverted > _MEASURED_M
    inverted = np.where(known, cv2.GaussianBlur(inverted, (5, 5), 0), inverted)
    return np.where(known, max_depth_m - inverted, 0.0).astype(np.float32)


def _full(size: int) -> npt.NDArray[np.uint8]:
    return np.ones((size, size), dtype=np.uint8)


def _diamond(size: int) -> npt.NDArray[np.uint8]:
    offset = np.abs(np.arange(size) - size // 2)
    return (offset[:, None] + offset[None, :] <= size // 2).astype(np.uint8)


def _fill_empty(inverted: MatLike, kernel: npt.NDArray[np.uint8]) -> MatLike:
    """Fill pixels without a value from a dilation, leaving the others as they are."""
    return np.where(inverted > _MEASURED_M, inverted, cv2.dilate(inverted, kernel))


def _extend_to_top(inverted: MatLike) -> MatLike:
    """Continue every column upwards from its topmost value; LiDAR sees nothing above it."""
    known = inverted > _MEASURED_M
    top = np.argmax(known, axis=0)  # 0 in a column without any value: nothing to continue there
    top_value = inverted[top, np.arange(inverted.shape[1])]
    above = np.arange(inverted.shape[0])[:, None] < top
    return np.where(above, top_value, inverted)


#: The baselines by the name that tables give them.
BASELINES: Mapping[str, Fill] = {"nearest filling": nearest_fill, "IP-Basic": ip_basic}
