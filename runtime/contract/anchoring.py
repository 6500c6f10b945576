"""Predicted depth moved to the returns of the frame's own size, before it is resized to it.

The network of a large camera runs at a smaller size, at which a return loses its place by up to
half a cell. Where a return of the frame and the predicted depth at its exact place agree, their
ratio is applied to the predicted depth around it, on one surface.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.resize import is_one_surface

Floats = NDArray[Any]  # float32

#: Largest log ratio of a return to the predicted depth at which they agree.
AGREE = 0.03
#: Root mean square of the log ratios of the surrounding predicted depths to a pixel's own, up to
#: which they are one surface with it.
ONE_SURFACE = 0.06
#: Side of a cell of the sums, in pixels of the network, and times that their grid is halved.
CELL, LEVELS = 2, 2
#: Cells that a window of 3 x 3 with the weights 1, 2, 1 averages over, (16 / 6) ** 2.
_CELLS = 7.1
#: Largest share by which agreeing returns reduce the uncertainty.
REDUCTION = 0.4
_LEAST_DEPTH_M = np.float32(1e-3)
_TENT = np.array([0.25, 0.5, 0.25], np.float32)


def move_to_returns(depth: Floats, uncertainty: Floats | None, returns: Floats) -> None:
    """Move a predicted depth to the returns that agree with it, in place, see `anchor`.

    Args:
        depth: predicted, float32 (h, w), metres.
        uncertainty: of the depth, float32 (h, w), metres, reduced beside returns; None = the model
            has none.
        returns: of the frame, float32 (H, W), metres, 0 = no return.
    """
    factors = anchor(np.maximum(depth, _LEAST_DEPTH_M), returns)
    if factors is not None:
        depth *= factors.ratio
        if uncertainty is not None:
            uncertainty *= factors.uncertainty


class Anchored(NamedTuple):
    """Maps on the grid of the network, each float32 (h, w)."""

    #: What the predicted depth is multiplied by, exp(-AGREE)..exp(AGREE).
    ratio: Floats
    #: What its uncertainty is multiplied by, 1 - REDUCTION..1.
    uncertainty: Floats


def anchor(depth: Floats, returns: Floats) -> Anchored | None:
    """Return the factors that move a predicted depth to the returns that agree with it.

    Sums over the agreeing returns of each cell of CELL x CELL pixels are averaged in windows of
    growing width. In each window the mean log ratio counts by the number of its returns, up to one
    for a full window, and narrower windows come first. A window counts only where the predicted
    depths at its returns are one surface with the cell's own, and the factors are 1 at edges of the
    predicted depth, so a ratio never crosses an edge.

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
    # Whole cells of the coarsest window, by repeating the last rows and columns.
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
    sums = cv2.merge((count, ratios, count * log_depth, count * log_depth * log_depth))
    moved, left = np.zeros_like(log_depth), np.ones_like(log_depth)
    for level in range(LEVELS + 1):
        share, mean = _window(sums, log_depth, level)
        share *= left
        moved += share * mean
        left -= share
        if level == 0:
            confirmed = share
    maps = cv2.merge((moved, confirmed))
    maps = cv2.resize(maps, padded.shape[::-1], interpolation=cv2.INTER_LINEAR)[:height, :width]
    maps = maps * is_surface[..., np.newaxis]
    return Anchored(np.exp(maps[..., 0]), 1 - np.float32(REDUCTION) * maps[..., 1])


def _window(sums: Floats, log_depth: Floats, level: int) -> tuple[Floats, Floats]:
    """Return the share, 0..1, and the mean log ratio of the returns in the window of a level.

    sums: over the returns of each cell, (h, w, 4): their number, log ratios, log depths and squared
    log depths; whole cells of the level.
    """
    (height, width), side = log_depth.shape, 2**level
    if level:
        coarse = (width // side, height // side)
        sums = cv2.resize(sums, coarse, interpolation=cv2.INTER_AREA)
    sums = cv2.sepFilter2D(sums, -1, _TENT, _TENT, borderType=cv2.BORDER_CONSTANT)
    count, ratios, logs, squares = cv2.split(sums)
    per_return = 1 / np.maximum(count, np.float32(1e-6))
    share = np.minimum(count * np.float32(_CELLS * side * side), 1)
    maps = cv2.merge((share, ratios * per_return, logs * per_return, squares * per_return))
    if level:
        maps = cv2.resize(maps, (width, height), interpolation=cv2.INTER_LINEAR)
    share, ratio, mean, square = cv2.split(maps)
    # The mean square of the differences to the cell's own log depth.
    share[square + log_depth * (log_depth - 2 * mean) > ONE_SURFACE**2] = 0
    return share, ratio


def _place(pixels: NDArray[np.intp], old: int, new: int) -> NDArray[np.float64]:
    """The coordinate of each pixel's centre on the grid of the network, within its centres."""
    return np.clip((pixels + 0.5) * (new / old) - 0.5, 0, new - 1)


def _depth_at(
    depth: Floats,
    is_surface: NDArray[np.bool_],
    row: NDArray[np.float64],
    column: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The predicted depth at fractional places, as `resize_surface` would have it there."""
    top = np.minimum(row.astype(np.intp), depth.shape[0] - 2)
    left = np.minimum(column.astype(np.intp), depth.shape[1] - 2)
    down, right = row - top, column - left
    upper = (1 - right) / depth[top, left] + right / depth[top, left + 1]
    lower = (1 - right) / depth[top + 1, left] + right / depth[top + 1, left + 1]
    smooth = 1 / (upper * (1 - down) + lower * down)
    cells = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)
    return np.where(is_surface[cells], smooth, depth[cells])
