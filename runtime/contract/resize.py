"""Resizing of frames and answers, the same for inference and training.

Integers are pixel centres, as in `runtime.geometry.projection`. When a side of `old` pixels is
resized to `new`, a centre u moves to u' = (u + 0.5) * new / old - 0.5. A return at u falls into the
pixel rint(u'), rounded half to even, like a projected return.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arrays import Bools, Float32, Indices, Size
from runtime.contract.heads import ResizeRule

# The pixel and its eight neighbours.
_AROUND = np.ones((3, 3), np.uint8)
# Neighbouring depths are one surface if the farthest is at most this multiple of the nearest.
SAME_SURFACE = 1.15


def resize_image(image: NDArray[Any], size: Size) -> NDArray[Any]:
    """Resize an image or a map of probabilities or scores, (H, W) or (H, W, C), to `size`.

    A side that shrinks is averaged by area, so that no pixel is skipped; a side that grows is
    interpolated linearly.
    """
    height, width = size
    # OpenCV averages areas only if no side grows, so the shrinking sides are resized first.
    smaller = min(height, image.shape[0]), min(width, image.shape[1])
    if image.shape[:2] != smaller:
        image = cv2.resize(image, smaller[::-1], interpolation=cv2.INTER_AREA)
    if image.shape[:2] != size:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return image


def resize_nearest(values: NDArray[Any], size: Size) -> NDArray[Any]:
    """Resize class ids or dense depth, (H, W), to `size`: each pixel takes the nearest centre."""
    height, width = size
    # Plain INTER_NEAREST would shift the map by up to half a pixel.
    return cv2.resize(values, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)


def resize_surface(depth: Float32, size: Size) -> Float32:
    """Resize a map of predicted depth, (H, W), to `size`; two surfaces are never mixed.

    When the map grows, inverse depth is interpolated bilinearly if the 3 x 3 pixels around the
    nearest centre are one surface, see `SAME_SURFACE`; on a plane, inverse depth is an affine
    function of the pixel. Elsewhere, and when a side shrinks, each pixel takes the nearest centre.
    """
    resized = resize_nearest(depth, size)
    if size[0] < depth.shape[0] or size[1] < depth.shape[1]:
        return resized
    is_surface = is_one_surface(depth)
    # Depths of 0 belong to no surface, so there is no division by 0.
    inverse = cv2.resize(cv2.divide(1.0, depth), size[::-1], interpolation=cv2.INTER_LINEAR)
    cv2.copyTo(cv2.divide(1.0, inverse), resize_nearest(is_surface.astype(np.uint8), size), resized)
    return resized


def is_one_surface(depth: Float32) -> Bools:
    """Return whether the 3 x 3 pixels around each pixel are one surface, see `SAME_SURFACE`."""
    farthest, nearest = cv2.dilate(depth, _AROUND), cv2.erode(depth, _AROUND)
    return (nearest > 0) & (farthest <= SAME_SURFACE * nearest)


# Rule of `HEADS` -> its function, which takes an array (H, W) and the new size.
RESIZE: dict[ResizeRule, Callable[[NDArray[Any], Size], NDArray[Any]]] = {
    "nearest": resize_nearest,
    "bilinear": resize_image,
    "surface": resize_surface,
}


def move_returns(sparse_depth: Float32, size: Size) -> Float32:
    """Move each return of a sparse depth map to its pixel in a map of another size.

    No return is duplicated or mixed with another. If several returns fall into one pixel, the
    nearest is kept, like in a projected scan. NaN and negative values are dropped.

    Args:
        sparse_depth: float32 (H, W), metres, 0 = no return.
        size: (height, width) of the result.

    Returns:
        float32 of `size`, metres, 0 = no return.
    """
    source, target = _moves(sparse_depth, size)
    return _moved(sparse_depth, source, target, size, nothing=0)


def move_scan_lines(
    sparse_depth: Float32, scan_line: NDArray[np.int16], size: Size
) -> tuple[Float32, NDArray[np.int16]]:
    """Move returns as `move_returns` does, and their scan lines: int16 (H, W), -1 = none."""
    source, target = _moves(sparse_depth, size)
    return (
        _moved(sparse_depth, source, target, size, nothing=0),
        _moved(scan_line, source, target, size, nothing=-1),
    )


def _moved(
    values: NDArray[Any], source: NDArray[Any], target: NDArray[Any], size: Size, *, nothing: int
) -> NDArray[Any]:
    moved = np.full(size[0] * size[1], nothing, dtype=values.dtype)
    moved[target] = values.ravel()[source]
    return moved.reshape(size)


def _moves(sparse_depth: Float32, size: Size) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return flat indices of the returns that are kept, and of their pixels in `size`."""
    (height, width), (new_height, new_width) = sparse_depth.shape, size
    # np.nonzero is four times as fast on a mask as on floats.
    source = np.flatnonzero(sparse_depth > 0)
    row, column = np.divmod(source, width)
    target = _moved_pixels(height, new_height)[row] * new_width
    target += _moved_pixels(width, new_width)[column]
    depth = sparse_depth.ravel()[source]
    nearest = np.full(new_height * new_width, np.inf, dtype=np.float32)
    np.minimum.at(nearest, target, depth)
    stays = depth == nearest[target]
    return source[stays], target[stays]


def _moved_pixels(old: int, new: int) -> Indices:
    """Return rint((u + 0.5) * new / old - 0.5) for each pixel u of a side, as integers (old,)."""
    numerator = (2 * np.arange(old) + 1) * new - old
    pixel, remainder = np.divmod(numerator, 2 * old)
    # Round half to even, as np.rint does; the remainder is in units of 1 / (2 * old).
    pixel[(remainder > old) | ((remainder == old) & (pixel % 2 == 1))] += 1
    return pixel
