"""Planes between the returns: inverse depth by local least squares, over a pyramid.

A plane in the world is an affine function of the pixel in inverse depth. Around each cell of a grid
the affine function that fits the returns best is found. The returns of a small window have their
full weight, those of the larger windows around it together the weight of a third of a return: they
count where the small one leaves a value or a slope open. Where the world is a plane, the result is
that plane, whatever the pattern of the returns. Local linear regression (Cleveland 1979) over a
pyramid (Gortler et al. 1996).

What a fit needs of the returns are nine sums. The sums of larger and of smaller cells, and around
other centres, are linear in them: each is a convolution with constant weights. Only the finest grid
is solved.
"""

import math
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from models.blocks import ramp, upsample
from models.pooling import cell_maxima, maxima_around

#: Half the width, in cells, of the two windows on the coarsest grid, and of the window on each
#: finer grid. The weight falls linearly to 0 there.
COARSE_WINDOWS, FINE_WINDOW = (6, 3), 2
#: Weight of all returns of a larger window together, in returns. Larger values smooth more.
LARGER_WINDOW_WEIGHT = 0.3
#: Weight of a slope of 0, in returns a cell away. Larger values flatten.
FLAT_WEIGHT = 0.002
#: Square of the distance of a cell from the centroid of the returns, in their standard deviations,
#: up to which there is a slope in full; from 1 more on there is none. Larger values continue slopes
#: farther beyond the returns.
INSIDE = 2.0
#: The result lies between the nearest and the farthest return of a window of so many coarsest
#: cells.
BOUND_WINDOW = 7
#: The sums are of 1; of r, c, z; of rr, cc, rc, zr, zc: r is below a centre, c to the right of it,
#: z the inverse depth. The powers of r and c of those without z, and of those with it, and their
#: places among all.
_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)), ((0, 0), (1, 0), (0, 1))
_PLACES = (0, 1, 2, 4, 5, 6), (3, 7, 8)
_SUMS = 9
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
        largest window; and the number of measured pixels in each cell, same shape.
    """
    device = inverse.device.type
    if device != "meta" and torch.is_autocast_enabled(device):
        with torch.autocast(device, enabled=False):  # sums of squares need single precision
            return fit_planes(inverse, mask, extremes, cell=cell, levels=levels)
    grids = [_convolve(torch.cat([mask, inverse], dim=1), _cell_kernel(cell), stride=cell)]
    for _ in range(levels):
        grids.append(_convolve(grids[-1], _coarser_kernel(), stride=2))
    largest, smaller = COARSE_WINDOWS
    around = _sums_around(grids[-1], largest)
    sums = _sums_around(grids[-1], smaller) + LARGER_WINDOW_WEIGHT * _of_one_return(around)
    inside = _inside(torch.cat([around, sums])).unflatten(0, (2, -1)).amax(dim=0)
    for grid in reversed(grids[:-1]):
        sums = _sums_around(grid, FINE_WINDOW) + _to_finer(_of_one_return(sums))
    plane = _solve(sums, upsample(inside, factor=2**levels))
    return _bound(plane, extremes, levels=levels), grids[0][:, :1]


def _of_one_return(sums: Tensor) -> Tensor:
    """Give all returns of a window together the weight of one; sums: (N, 9, h, w)."""
    return sums / sums[:, :1].clamp(min=_LEAST_COUNT)


def _inside(sums: Tensor) -> Tensor:
    """1 where a centre lies between its returns, 0 beyond them: for both slopes, (N, 2, h, w).

    Slopes between returns are measured, beyond them they are guessed.
    """
    _, about, moved = _about_centroid(sums)
    distance = moved[:, :2] / (about[:, :2] + _LEAST_SPREAD)
    return ramp(distance, -1.0, INSIDE + 1.0)


def _about_centroid(sums: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the means of r, c and z; the sums of rr, cc, rc, zr and zc about them; the difference.

    Products are taken of several channels at once: fewer and larger operations.
    """
    count, first, second = sums.split([1, 3, 5], dim=1)
    mean = first / count.clamp(min=_LEAST_COUNT)
    moved = _take(mean, (0, 1, 0, 0, 1)) * _take(first, (0, 1, 1, 2, 2))
    return mean, second - moved, moved


def _solve(sums: Tensor, inside: Tensor) -> Tensor:
    """Fit a plane to the returns around each centre: its value there, (N, 1, h, w).

    sums: (N, 9, h, w); inside: the share of both slopes that is believed, see `_inside`.
    """
    mean, about, _ = _about_centroid(sums)
    flat = (FLAT_WEIGHT, FLAT_WEIGHT, 0.0, 0.0, 0.0)
    about = about + about.new_tensor(flat).view(1, len(flat), 1, 1)
    # Cramer's rule, of rr, cc, rc, zr and zc.
    products = _take(about, (1, 2, 0, 2, 0, 2)) * _take(about, (3, 4, 4, 3, 1, 2))
    numerators, determinant = _convolve(products, _PAIRS).split([2, 1], dim=1)
    slopes = numerators * (inside / determinant)
    place, value = mean.split([2, 1], dim=1)
    plane: Tensor = value - (place * slopes).sum(dim=1, keepdim=True)
    return plane


#: Kernel (3, 6, 1, 1): the difference of each pair of channels.
_PAIRS = np.kron(np.eye(3), [1.0, -1.0]).astype(np.float32)[:, :, None, None]


def _bound(plane: Tensor, extremes: Tensor, *, levels: int) -> Tensor:
    """Limit the plane to the inverse depths around it, see BOUND_WINDOW."""
    around = maxima_around(cell_maxima(extremes, 2**levels), BOUND_WINDOW)
    nearest, farthest = around.split(1, dim=1)
    least = nearest.clamp(max=1.0) / farthest.clamp(min=_LEAST_COUNT)  # 0 without returns
    nearest = torch.where(nearest > 0, nearest, torch.inf)
    bounds = torch.cat([least, nearest], dim=1)
    least, nearest = F.interpolate(bounds, scale_factor=float(2**levels), mode="nearest").split(
        1, dim=1
    )
    return torch.minimum(torch.maximum(plane, least), nearest)


def _sums_around(sums: Tensor, window: int) -> Tensor:
    """Sum the cells around each, weighted by a tent of half the width ``window``."""
    return _convolve(sums, _window_kernel(window), padding=window - 1)


def _to_finer(sums: Tensor) -> Tensor:
    """Sums around the centres of cells half as wide, of the four closest, weighted bilinearly.

    The result is multiplied by LARGER_WINDOW_WEIGHT.
    """
    return F.conv_transpose2d(sums, torch.from_numpy(_finer_kernel()).to(sums), stride=2, padding=1)


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
    for channel, (powers, places) in enumerate(zip(_POWERS, _PLACES, strict=True)):
        for (down, right), index in zip(powers, places, strict=True):
            kernel[index, channel] = place[:, None] ** down * place[None, :] ** right
    return kernel


@cache
def _coarser_kernel() -> NDArray[np.float32]:
    """Kernel (9, 9, 2, 2): the sums of four cells to those of the cell that they make up."""
    kernel = np.zeros((_SUMS, _SUMS, 2, 2), np.float32)
    for row, column in np.ndindex(2, 2):
        kernel[:, :, row, column] = _moved((row - 0.5) / 2, (column - 0.5) / 2, scale=0.5)
    return kernel


@cache
def _finer_kernel() -> NDArray[np.float32]:
    """Kernel (9, 9, 4, 4) of a transposed convolution: the sums of a cell to the finer ones."""
    kernel = np.zeros((_SUMS, _SUMS, 4, 4), np.float32)
    for row, column in np.ndindex(4, 4):
        down, right = 1.5 - row, 1.5 - column  # of the cell's centre from the finer one's
        weight = LARGER_WINDOW_WEIGHT * (1 - abs(down) / 2) * (1 - abs(right) / 2)
        kernel[:, :, row, column] = weight * _moved(down, right, scale=2.0).T
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
    for powers, places in zip(_POWERS, _PLACES, strict=True):
        for new, row in zip(powers, places, strict=True):
            for old, column in zip(powers, places, strict=True):
                matrix[row, column] = np.prod(
                    [
                        math.comb(power, kept) * scale**kept * offset ** (power - kept)
                        if kept <= power
                        else 0.0
                        for power, kept, offset in zip(new, old, (down, right), strict=True)
                    ]
                )
    return matrix
