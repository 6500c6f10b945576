"""Checks, cleaning and resizing of a frame before it enters the network."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from runtime.base.arguments import array_dtype
from runtime.base.arrays import Float32, Size, UInt8
from runtime.base.errors import InputError
from runtime.contract.canonical_focal import CameraScale
from runtime.contract.contract import MIN_SIDE, farthest_return
from runtime.contract.degraded import NO_DEPTH, SPARSE_DEPTH_LOW
from runtime.contract.resize import move_returns, resize_image
from runtime.engine.image_quality import find_doubts
from runtime.engine.prediction import Cleaned, ms_since
from runtime.geometry.returns import drop_saturated

# The image is divided into a fixed number of cells. 16 of KITTI's 64 lines have returns in 6.6 %
# of the cells, 4 lines in 1.8 %, at any resolution. Two lines (0.5 %), or 16 lines with a tenth of
# their returns (0.75 %), are a fault.
_GRID = (128, 416)
_LOW_SHARE = 0.01  # of the cells


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """A frame that is ready for the network.

    Attributes:
        rgb: uint8 (h, w, 3) at the network's size.
        sparse_depth: float32 (h, w) at the network's size, metres times `scale.factor`, 0 =
            no measurement.
        frame_size: (height, width) of the frame.
        full_size_returns: float32 (H, W) at the frame's size, metres, 0 = no measurement; None if
            the network does not run at a smaller size, or the frame has no returns.
        cleaned: numbers of depth pixels of the frame that were changed.
        depth_returns: number of depth pixels of the frame that remain.
        degraded: reasons why the answer is less reliable than usual.
        scale: conversion from metres to the network's depth.
        preprocess_ms: time of checking, cleaning and resizing.
    """

    rgb: UInt8
    sparse_depth: Float32
    frame_size: Size
    full_size_returns: Float32 | None
    cleaned: Cleaned
    depth_returns: int
    degraded: tuple[str, ...]
    scale: CameraScale
    preprocess_ms: float

    @property
    def network_size(self) -> Size:
        """(height, width) at which the network runs."""
        return self.rgb.shape[0], self.rgb.shape[1]


def preprocess(
    rgb: Any,
    sparse_depth: Any,
    *,
    size_for: Callable[[Size], Size],
    scale_for: Callable[[Size], CameraScale],
) -> NetworkInput:
    """Check and clean a frame and bring it to the network's size.

    Args:
        rgb: uint8 (H, W, 3), RGB.
        sparse_depth: float32 (H, W), metres; None: predict from the image alone.
        size_for: frame size -> network size, both (height, width).
        scale_for: frame size -> scale of its depth.

    Raises:
        InputError: if an array has another type or shape.
    """
    started = time.perf_counter()
    rgb = check_rgb(rgb)
    frame_size = (rgb.shape[0], rgb.shape[1])
    if sparse_depth is None:
        sparse_depth = np.zeros(frame_size, np.float32)
    sparse_depth = check_sparse_depth(sparse_depth, size=frame_size)
    size, scale = size_for(frame_size), scale_for(frame_size)
    sparse_depth, cleaned, returns = clean_sparse_depth(sparse_depth, max_depth_m=scale.range_m)
    degraded = list(find_doubts(rgb))
    network_rgb, fed, full_size_returns = rgb, returns, None
    if size != frame_size:
        if returns and size[0] <= frame_size[0] and size[1] <= frame_size[1]:
            full_size_returns = sparse_depth
        network_rgb = resize_image(rgb, size)
        sparse_depth = move_returns(sparse_depth, size)
        fed = cv2.countNonZero(sparse_depth)
    if scale.factor != 1:
        sparse_depth = sparse_depth * np.float32(scale.factor)
        # Rounding must not move the farthest return out of the range.
        farthest = np.float32(scale.range_m * scale.factor)
        np.minimum(sparse_depth, farthest, out=sparse_depth)
    if returns == 0:
        degraded.insert(0, NO_DEPTH)
    elif covers_little(sparse_depth, returns=fed):
        degraded.insert(0, SPARSE_DEPTH_LOW)
    arrays = network_rgb, sparse_depth, frame_size, full_size_returns
    return NetworkInput(*arrays, cleaned, returns, tuple(degraded), scale, ms_since(started))


def check_rgb(rgb: Any) -> UInt8:
    """Return `rgb`, contiguous; InputError unless it is uint8 (H, W, 3), each side >= MIN_SIDE."""
    if (kind := array_dtype(rgb)) != np.uint8:
        raise InputError(
            f"rgb must be a plain numpy array of uint8, values 0..255, got {kind}: give the "
            "camera's pixels as they are, the network normalises them itself"
        )
    if rgb.ndim != 3 or rgb.shape[2] != 3:
        hint = ""
        if rgb.ndim == 2 or (rgb.ndim == 3 and rgb.shape[2] == 1):
            hint = ": it is a grey image, use cv2.cvtColor(rgb, cv2.COLOR_GRAY2RGB)"
        elif rgb.ndim == 3 and rgb.shape[2] == 4:
            hint = ": it has an alpha channel, use rgb[..., :3]"
        elif rgb.ndim == 3 and rgb.shape[0] == 3:
            hint = ": channels come last, use rgb.transpose(1, 2, 0)"
        raise InputError(f"rgb must have the shape (H, W, 3), got {rgb.shape}{hint}")
    if min(rgb.shape[:2]) < MIN_SIDE:
        raise InputError(f"rgb must be at least {MIN_SIDE} x {MIN_SIDE} pixels, got {rgb.shape}")
    return np.ascontiguousarray(rgb)


def check_sparse_depth(sparse_depth: Any, *, size: Size) -> Float32:
    """Return `sparse_depth`, contiguous; InputError unless it is float32 (H, W) of `size`."""
    if (kind := array_dtype(sparse_depth)) != np.float32:
        hint = "use np.asarray(sparse_depth, np.float32), of a masked array its .filled(0)"
        if "int" in str(kind):
            hint = (
                "the unit of integers is not known: convert to metres first, for KITTI's PNG files "
                "with (pixels / 256).astype(np.float32)"
            )
        raise InputError(
            f"sparse_depth must be a plain numpy array of float32, metres, got {kind}: {hint}"
        )
    if sparse_depth.shape != size:
        raise InputError(
            f"sparse_depth must have the shape (H, W) of rgb, {size}, got {sparse_depth.shape}"
        )
    return np.ascontiguousarray(sparse_depth)


def clean_sparse_depth(
    sparse_depth: Float32, *, max_depth_m: float
) -> tuple[Float32, Cleaned, int]:
    """Replace invalid depth by 0 and clip returns to the range, see `farthest_return`.

    Args:
        sparse_depth: float32 (H, W), metres; it is not changed.
        max_depth_m: the depth range.

    Returns:
        The depth (the same array if it was clean), the numbers of cleaned pixels, and the number of
        measurements that remain.
    """
    low, high = sparse_depth.min(), sparse_depth.max()  # both NaN if any pixel is
    farthest = farthest_return(max_depth_m)
    cleared = drop_saturated(sparse_depth, np.fmin(farthest, high))
    if cleared is sparse_depth and low >= 0 and high <= max_depth_m:
        return sparse_depth, Cleaned(), cv2.countNonZero(sparse_depth)
    sparse_depth = cleared
    usable = (sparse_depth >= 0) & (sparse_depth <= farthest)
    refused = sparse_depth[~usable]
    infinite = np.isinf(refused)
    kept = np.where(usable, np.minimum(sparse_depth, np.float32(max_depth_m)), np.float32(0))
    cleaned = Cleaned(
        nan=int(np.isnan(refused).sum()),
        infinite=int(infinite.sum()),
        negative=int(((refused < 0) & ~infinite).sum()),
        too_far=int((np.isfinite(sparse_depth) & (sparse_depth > max_depth_m)).sum()),
    )
    return kept, cleaned, cv2.countNonZero(kept)


def covers_little(sparse_depth: Float32, *, returns: int) -> bool:
    """Return whether the returns lie in fewer than `_LOW_SHARE` of the image's cells, see `_GRID`.

    The cells make the result independent of the camera's resolution. A cell is at least one pixel.
    `returns` is the number of returns.
    """
    height, width = sparse_depth.shape
    rows, columns = min(_GRID[0], height), min(_GRID[1], width)
    needed = _LOW_SHARE * rows * columns
    largest_cell = math.ceil(height / rows) * math.ceil(width / columns)
    if returns >= needed * largest_cell:
        return False  # fewer cells could not hold so many returns
    row, column = np.divmod(np.flatnonzero(sparse_depth > 0), width)
    occupied = np.zeros(rows * columns, dtype=np.bool_)
    occupied[row * rows // height * columns + column * columns // width] = True
    return bool(np.count_nonzero(occupied) < needed)
