"""Correction of predicted depth by the returns at the frame's own size.

For a large camera the network runs at a smaller size, where a return is displaced by up to half a
cell. If a return of the frame agrees with the predicted depth at its exact place, the ratio of both
is applied to the predicted depth around it, on the same surface. This is done before the depth is
resized to the frame.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arrays import Bools, Float64, Indices
from runtime.contract.resize import is_one_surface

Floats = NDArray[Any]  # float32

# A return and the predicted depth agree up to this log ratio.
AGREE = 0.03
# Surrounding predicted depths are on one surface with a pixel up to this root mean square of their
# log ratios to the pixel's own depth.
ONE_SURFACE = 0.06
# The sums have cells of this side, in pixels of the network; their grid is halved so many times.
CELL, LEVELS = 2, 2
# Effective number of cells in a window of 3 x 3 with the weights 1, 2, 1: (16 / 6) ** 2.
_CELLS = 7.1
# Largest share by which agreeing returns reduce the uncertainty.
REDUCTION = 0.4
_LEAST_DEPTH_M = np.float32(1e-3)
_TENT = np.array([0.25, 0.5, 0.25], np.float32)


def move_to_returns(
    depth: Floats, uncertainty: Floats | None, returns: Floats, *, range_m: float
) -> None:
    """Correct a predicted depth, in place, by the returns that agree with it, see `anchor`.

    Args:
        depth: predicted, float32 (h, w), metres.
        uncertainty: of the depth, float32 (h, w), metres; it is reduced near returns. None if the
            model has no uncertainty.
        returns: of the frame, float32 (H, W), metres, 0 = no return.
        range_m: no depth is moved beyond it.
    """
    factors = anchor(np.maximum(depth, _LEAST_DEPTH_M), returns)
    if factors is not None:
        depth *= factors.ratio
        np.minimum(depth, np.float32(range_m), out=depth)
        if uncertainty is not None:
            uncertainty *= factors.uncertainty


class Anchored(NamedTuple):
    """Maps on the grid of the network, each float32 (h, w).

    Attributes:
        ratio: factor for the predicted depth, exp(-AGREE)..exp(AGREE).
        uncertainty: factor for the uncertainty, 1 - REDUCTION..1.
    """

    ratio: Floats
    uncertainty: Floats


def anchor(depth: Floats, returns: Floats) -> Anchored | None:
    """Return the factors that move a predicted depth to the returns that agree with it.

    Sums over the agreeing returns of each cell of `CELL` x `CELL` pixels are averaged in windows of
    growing width. The mean log ratio of a window has a weight that grows with the number of its
    returns, up to 1 for a full window, and narrower windows come first. A window counts only if the
    predicted depths at its returns are one surface with the cell's own depth. The factors are 1 at
    edges of the predicted depth, so a ratio never crosses an edge.

    Args:
        depth: predicted, float32 (h, w), metres, above 0.
        returns: of the frame, float32 (H, W), H >= h and W >= w, metres, 0 = no return.

    Returns:
        The factors, or None if no return agrees.
    """
    (height, width), is_surface = depth.shape, is_one_surface(depth)
    rows, columns = np.divmod(np.flatnonzero(returns > 0), returns.shape[1])
    down = _place(rows, returns.shape[0], height)
    right = _place(columns, returns.shape[1], width)
    ratio = np.log(returns[rows, columns] / _depth_at(depth, is_surface, down, right))
    agrees = np.abs(ratio) < AGREE
    if not agrees.any():
        return None
    # Repeat the last rows and columns until there are whole cells of the coarsest window.
    side = CELL * 2**LEVELS
    padded = cv2.copyMakeBorder(depth, 0, -height % side, 0, -width % side, cv2.BORDER_REPLICATE)
    log_depth = cv2.log(np.ascontiguousarray(padded[CELL // 2 :: CELL, CELL // 2 :: CELL]))
    cells = np.rint(down).astype(np.intp) // CELL * log_depth.shape[1]
    cells += np.rint(right).astype(np.intp) // CELL
    count, ratios = (
        np.bincount(cells[agrees], weights, log_depth.size)
        .astype(np.float32)
        .reshape(log_depth.shape)
        for weights in (None, ratio[agrees])
    )
    logs = count * log_depth
    sums = count, ratios, logs, logs * log_depth
    moved, left = np.zeros_like(log_depth), np.ones_like(log_depth)
    for level in range(LEVELS + 1):
        share, mean = _window(sums, log_depth, level)
        share *= left
        moved += share * mean
        left -= share
        if level == 0:
            confirmed = share
    large, mask = padded.shape[::-1], is_surface.view(np.uint8)
    moved, confirmed = (
        cv2.copyTo(cv2.resize(m, large, interpolation=cv2.INTER_LINEAR)[:height, :width], mask)
        for m in (moved, confirmed)
    )
    return Anchored(cv2.exp(moved), 1 - np.float32(REDUCTION) * confirmed)


def _window(
    sums: tuple[Floats, Floats, Floats, Floats], log_depth: Floats, level: int
) -> tuple[Floats, Floats]:
    """Return the share, 0..1, and the mean log ratio of the returns in the window of a level.

    `sums` are the sums over the returns of each cell, (h, w) each: their number, log ratios, log
    depths and squared log depths. h and w are multiples of the level's cell.
    """
    # Each plane alone: OpenCV takes twice as long for four channels together.
    (height, width), side = log_depth.shape, 2**level
    count, *others = (_tent(each, (width // side, height // side)) for each in sums)
    per_return = 1 / np.maximum(count, np.float32(1e-6))
    maps = [np.minimum(count * np.float32(_CELLS * side * side), 1)]
    maps += [each * per_return for each in others]
    if level:
        maps = [cv2.resize(m, (width, height), interpolation=cv2.INTER_LINEAR) for m in maps]
    share, ratio, mean, square = maps
    # The mean square of the differences to the cell's own log depth.
    share[square + log_depth * (log_depth - 2 * mean) > ONE_SURFACE**2] = 0
    return share, ratio


def _tent(plane: Floats, size: tuple[int, int]) -> Floats:
    """Return the means in cells, (width, height) of them, weighted 1, 2, 1 along both sides."""
    if plane.shape[::-1] != size:
        plane = cv2.resize(plane, size, interpolation=cv2.INTER_AREA)
    return cv2.sepFilter2D(plane, -1, _TENT, _TENT, borderType=cv2.BORDER_CONSTANT)


def _place(pixels: Indices, old: int, new: int) -> Float64:
    """Return where pixel centres lie on the network's grid, clipped to its outermost centres."""
    return np.clip((pixels + 0.5) * (new / old) - 0.5, 0, new - 1)


def _depth_at(depth: Floats, is_surface: Bools, row: Float64, column: Float64) -> Float64:
    """Return the predicted depth at fractional places, interpolated like in `resize_surface`."""
    top = np.minimum(row.astype(np.intp), depth.shape[0] - 2)
    left = np.minimum(column.astype(np.intp), depth.shape[1] - 2)
    down, right = row - top, column - left
    upper = (1 - right) / depth[top, left] + right / depth[top, left + 1]
    lower = (1 - right) / depth[top + 1, left] + right / depth[top + 1, left + 1]
    smooth = 1 / (upper * (1 - down) + lower * down)
    cells = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)
    return np.where(is_surface[cells], smooth, depth[cells])
