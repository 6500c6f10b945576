"""Check and clean what goes into the network."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract import MIN_SIDE
from runtime.errors import InputError
from runtime.prediction import Cleaned

_CONSTANT_STEP = 16  # a look at every 16th pixel is enough to rule out a constant picture


def check_rgb(rgb: Any) -> NDArray[np.uint8]:
    """Give back `rgb`, contiguous.

    rgb: uint8 (H, W, 3), red first, H and W at least MIN_SIDE.
    Raises InputError for anything else.
    """
    if not isinstance(rgb, np.ndarray) or isinstance(rgb, np.ma.MaskedArray):
        raise InputError(
            f"rgb must be a plain numpy array, got {type(rgb).__name__}: a mask would be lost"
        )
    if rgb.ndim != 3 or rgb.shape[2] != 3:
        hint = ""
        if rgb.ndim == 3 and rgb.shape[0] == 3:
            hint = ": channels come last here, use rgb.transpose(1, 2, 0)"
        raise InputError(f"rgb must have the shape (H, W, 3), got {rgb.shape}{hint}")
    if rgb.dtype != np.uint8:
        raise InputError(
            f"rgb must be uint8 with values 0..255, got {rgb.dtype}: hand over the camera's "
            "pixels as they are, the network normalises them itself"
        )
    if min(rgb.shape[:2]) < MIN_SIDE:
        raise InputError(f"rgb must be at least {MIN_SIDE} x {MIN_SIDE} pixels, got {rgb.shape}")
    return np.ascontiguousarray(rgb)


def check_sparse_depth(sparse_depth: Any, *, size: tuple[int, int]) -> NDArray[np.float32]:
    """Give back `sparse_depth`, contiguous.

    sparse_depth: float32 (H, W) [m], 0 = no measurement.
    size: (height, width) of the picture it belongs to.
    Raises InputError for another type, rank or size.
    """
    if isinstance(sparse_depth, np.ma.MaskedArray):
        raise InputError(
            "sparse_depth must be a plain numpy array, got a masked one: 0 says that there is no "
            "measurement, use sparse_depth.filled(0)"
        )
    if not isinstance(sparse_depth, np.ndarray):
        raise InputError(f"sparse_depth must be a numpy array, got {type(sparse_depth).__name__}")
    if sparse_depth.dtype != np.float32:
        if sparse_depth.dtype.kind in "iu":
            hint = (
                "the unit of integers is not known: convert to metres first, for KITTI's PNG files "
                "with (pixels / 256).astype(np.float32)"
            )
        else:
            hint = "use sparse_depth.astype(np.float32)"
        raise InputError(f"sparse_depth must be float32 metres, got {sparse_depth.dtype}: {hint}")
    if sparse_depth.shape != size:
        raise InputError(
            f"sparse_depth must have the shape (H, W) of rgb, {size}, got {sparse_depth.shape}"
        )
    return np.ascontiguousarray(sparse_depth)


def clean_sparse_depth(
    sparse_depth: NDArray[np.float32], *, max_depth_m: float
) -> tuple[NDArray[np.float32], Cleaned, int]:
    """Turn every impossible depth into "no measurement".

    sparse_depth: float32 (H, W) [m]; never written to.
    Returns the depth (the same array if it was clean), what was cleaned, and the number of
    measurements left.
    """
    low, high = sparse_depth.min(), sparse_depth.max()  # both NaN if any pixel is
    if low >= 0 and high <= max_depth_m:
        return sparse_depth, Cleaned(), cv2.countNonZero(sparse_depth)
    usable = (sparse_depth >= 0) & (sparse_depth <= max_depth_m)
    refused = sparse_depth[~usable]
    infinite = np.isinf(refused)
    cleaned = Cleaned(
        nan=int(np.isnan(refused).sum()),
        infinite=int(infinite.sum()),
        negative=int(((refused < 0) & ~infinite).sum()),
        too_far=int(((refused > max_depth_m) & ~infinite).sum()),
    )
    kept = np.where(usable, sparse_depth, np.float32(0))
    return kept, cleaned, cv2.countNonZero(kept)


def is_constant(rgb: NDArray[np.uint8]) -> bool:
    """Whether every pixel of `rgb`, uint8 (H, W, 3), has the same colour."""
    first = rgb[0, 0]
    if (rgb[::_CONSTANT_STEP, ::_CONSTANT_STEP] != first).any():
        return False
    return bool((rgb == first).all())
