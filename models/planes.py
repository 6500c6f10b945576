"""Planes between the returns: inverse depth by local least squares, coarse to fine.

A plane in the world is an affine function of the pixel in inverse depth. Around each cell of a grid
the affine function that fits the returns best is found, with weights that fall with the distance;
what the returns of a small window leave open is taken from a larger one (ridge regression towards
the coarser fit). Where the world is a plane, the result is that plane, whatever the pattern of the
returns. Local linear regression (Cleveland 1979) over a pyramid (Gortler et al. 1996).

What a fit needs of the returns are nine sums. The sums of larger cells, and around other centres,
are linear in them: each is a convolution with constant weights.
"""

import math
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from models.blocks import upsample
from models.pooling import cell_maxima, maxima_around

#: Half the width, in cells, of the windows on the coarsest grid, one after the other, and of the
#: window on each finer grid. The weight falls linearly to 0 there.
COARSE_WINDOWS, FINE_WINDOW = (8, 4, 2), 2
#: Weight of the larger window's fit, in returns: of its value at the cell's centre, and of its
#: slopes a cell. Larger values smooth more.
VALUE_WEIGHT, SLOPE_WEIGHT = 0.1, 1.0
#: Square of the distance of a cell from the centroid of the returns, in their standard deviations,
#: up to which a window changes the slope in full; from 1 more on it does not change it. Larger
#: values continue slopes farther beyond the returns.
INSIDE = 1.0
#: The result lies between the nearest and the farthest return of a window of so many coarsest
#: cells.
BOUND_WINDOW = 7
#: Powers of the places below and to the right of a centre: of the sums over returns, and of those
#: over their inverse depths.
_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1))
_WEIGHED = _POWERS[:3]
_SUMS = len(_POWERS) + len(_WEIGHED)
#: Kernel (3, 9, 1, 1): the sums of the rows of a 3 x 3 matrix.
_ROWS = np.kron(np.eye(3), np.ones(3)).astype(np.float32)[:, :, None, None]
#: Less than one return in a window, and less than any spread of several.
_LEAST_COUNT, _LEAST_SPREAD = 1e-3, 1e-2


def fit_planes(
    inverse: Tensor, mask: Tensor, extremes: Tensor, *, cell: int, levels: int
) -> tuple[Tensor, Tensor]:
    """Fit a plane around each cell.

    Args:
        inverse: inverse of the normalised depth, at least 1, (N, 1, H, W), 0 where nothing is
            measured; H and W are multiples of ``cell * 2**levels``.
        mask: 1 where measured, same shape.
        extremes: the greatest inverse depth and the greatest depth in each cell, (N, 2, h, w), 0
            where nothing is measured.
        cell: side of a cell in pixels.
        levels: number of coarser grids.

    Returns:
        Inverse depth at the cells' centres, (N, 1, h, w), 0 where no return is in reach of the
        largest window; and the share of measured pixels in each cell, same shape.
    """
    device = inverse.device.type
    if device != "meta" and torch.is_autocast_enabled(device):
        with torch.autocast(device, enabled=False):  # sums of squares need single precision
            return fit_planes(inverse, mask, extremes, cell=cell, levels=levels)
    grids = [_convolve(torch.cat([mask, inverse], dim=1), _cell_kernel(cell), stride=cell)]
    for _ in range(levels):
        grids.append(_convolve(grids[-1], _coarser_kernel(), stride=2))
    windows = [_sums_around(grids[-1], window) for window in COARSE_WINDOWS]
    count, total = windows[0][:, :1], windows[0][:, len(_POWERS) : len(_POWERS) + 1]
    # At first the mean of all returns around, without a slope.
    plane = F.pad(total / count.clamp(min=_LEAST_COUNT), (0, 0, 0, 0, 0, 2))
    for sums in windows:
        plane = _fit(sums, plane)
    for grid in reversed(grids[:-1]):
        # A slope a cell is half of that of a cell twice as wide.
        finer = upsample(plane) * plane.new_tensor([1.0, 0.5, 0.5]).view(1, 3, 1, 1)
        plane = _fit(_sums_around(grid, FINE_WINDOW), finer)
    return _bound(plane[:, :1], extremes, levels=levels), grids[0][:, :1] / cell**2


def _fit(sums: Tensor, prior: Tensor) -> Tensor:
    """Fit value and both slopes at the centre of each cell, (N, 3, h, w).

    sums: (N, 9, h, w), of the returns around it; prior: the fit that they change, as the result.
    Products are taken of several channels at once: fewer and larger operations.
    """
    # Normal equations of the difference from the prior plane; r is below, c to the right. Sums of
    # 1 (n), of r and c, of rr, cc and rc, and of the inverse depth z, of zr and zc.
    n, first, second, weighed = sums.split([1, 2, 3, 3], dim=1)
    matrix = _take(sums, (0, 1, 2, 1, 3, 5, 2, 5, 4))
    error = weighed - _convolve(matrix * _take(prior, (0, 1, 2) * 3), _ROWS)
    # The value is eliminated: what is left is about the centroid of the returns.
    per_return = 1.0 / (n + VALUE_WEIGHT)
    mean = first * per_return
    factors = torch.cat([first, error], dim=1)
    moved = _take(mean, (0, 1, 0, 0, 1)) * _take(factors, (0, 1, 1, 2, 2))
    value_error, slope_error = error.split([1, 2], dim=1)
    left = torch.cat([second, slope_error], dim=1) - moved
    variance, covariance, slope_error = left.split([2, 1, 2], dim=1)
    # Slopes between returns are measured, beyond them they are guessed.
    inside = (INSIDE + 1.0 - moved[:, :2] / (variance + _LEAST_SPREAD)).clamp(0.0, 1.0)
    # Cramer's rule.
    variance = variance + SLOPE_WEIGHT
    others = _take(torch.cat([variance, slope_error], dim=1), (1, 0, 3, 2))
    other_variance, other_error = others.split(2, dim=1)
    determinant = variance.prod(dim=1, keepdim=True) - covariance * covariance
    slopes = slope_error * other_variance - other_error * covariance
    slopes = slopes * (inside / determinant)
    value = value_error * per_return - (mean * slopes).sum(dim=1, keepdim=True)
    return prior + torch.cat([value, slopes], dim=1)


def _bound(plane: Tensor, extremes: Tensor, *, levels: int) -> Tensor:
    """Limit the plane to the inverse depths around it, see BOUND_WINDOW."""
    around = maxima_around(cell_maxima(extremes, 2**levels), BOUND_WINDOW)
    nearest, farthest = around.split(1, dim=1)
    least = (nearest > 0) / farthest.clamp(min=_LEAST_COUNT)
    nearest = torch.where(nearest > 0, nearest, torch.inf)
    bounds = torch.cat([least, nearest], dim=1)
    least, nearest = F.interpolate(bounds, scale_factor=float(2**levels), mode="nearest").split(
        1, dim=1
    )
    return torch.minimum(torch.maximum(plane, least), nearest)


def _sums_around(sums: Tensor, window: int) -> Tensor:
    """Sum the cells around each, weighted by a tent of half the width ``window``."""
    return _convolve(sums, _window_kernel(window), padding=window - 1)


def _take(x: Tensor, channels: tuple[int, ...]) -> Tensor:
    return x.index_select(1, torch.tensor(channels, device=x.device))


def _convolve(
    x: Tensor, kernel: NDArray[np.float32], *, stride: int = 1, padding: int = 0
) -> Tensor:
    return F.conv2d(x, torch.from_numpy(kernel).to(x), stride=stride, padding=padding)


@cache
def _cell_kernel(side: int) -> NDArray[np.float32]:
    """Kernel (9, 2, side, side): mask and inverse depth of pixels to the sums of their cell."""
    place = (np.arange(side) + 0.5) / side - 0.5
    kernel = np.zeros((_SUMS, 2, side, side), np.float32)
    for index, (down, right) in enumerate((*_POWERS, *_WEIGHED)):
        values = place[:, None] ** down * place[None, :] ** right
        kernel[index, int(index >= len(_POWERS))] = values
    return kernel


@cache
def _coarser_kernel() -> NDArray[np.float32]:
    """Kernel (9, 9, 2, 2): the sums of four cells to those of the cell that they make up."""
    kernel = np.zeros((_SUMS, _SUMS, 2, 2), np.float32)
    for row, column in np.ndindex(2, 2):
        kernel[:, :, row, column] = _moved((row - 0.5) / 2, (column - 0.5) / 2, scale=0.5)
    return kernel


@cache
def _window_kernel(window: int) -> NDArray[np.float32]:
    """Kernel (9, 9, 2 w - 1, 2 w - 1): the weighted sums around the centre cell, w the window."""
    side = 2 * window - 1
    kernel = np.zeros((_SUMS, _SUMS, side, side), np.float32)
    for row, column in np.ndindex(side, side):
        down, right = row - window + 1, column - window + 1
        weight = (1 - abs(down) / window) * (1 - abs(right) / window)
        kernel[:, :, row, column] = weight * _moved(down, right)
    return kernel


def _moved(down: float, right: float, *, scale: float = 1.0) -> NDArray[Any]:
    """Matrix (9, 9): sums around a centre to those around another.

    A place p from the old centre is ``scale * p`` plus (down, right) from the new one; its powers
    are binomials of the old ones.
    """
    matrix = np.zeros((_SUMS, _SUMS))
    for start, powers in ((0, _POWERS), (len(_POWERS), _WEIGHED)):
        for row, new in enumerate(powers):
            for column, old in enumerate(powers):
                matrix[start + row, start + column] = np.prod(
                    [
                        math.comb(power, kept) * scale**kept * offset ** (power - kept)
                        if kept <= power
                        else 0.0
                        for power, kept, offset in zip(new, old, (down, right), strict=True)
                    ]
                )
    return matrix
