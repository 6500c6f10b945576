"""The base of the depth: planes between the returns that pass through the returns on them.

The paper has no such part: its network reads the sparse depth as a fourth channel and has to learn
to interpolate it. Nothing is learned here, so other cameras and LiDARs get the same result.

The inverse depth of a plane is an affine function of the pixel. For each cell of a grid the affine
function that fits the returns around it best is found: local linear regression (Cleveland 1979)
over a pyramid of windows (Gortler et al. 1996). The returns of the smallest window have their full
weight. All returns of a larger window together have the weight of a third of a return, so they
matter where the smaller window does not determine a value or a slope. Where the scene is a plane,
the result is that plane, whatever the pattern of the returns.

A fit needs nine moments of the returns: the sums of their coordinates, inverse depths, and products
of both. The moments of larger and of smaller cells, and those around other centres, are linear
functions of these: convolutions with constant weights. Only the finest grid is solved. On a grid of
half the cell size, the residuals of the returns are then averaged around them and added to the
planes: `add_residuals`.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from models.blocks import hard_sigmoid, upsample
from models.pooling import cell_maxima, cell_means, window_maxima

# Side of a cell of the planes [pixels], and how often their grid is halved: up to a stride of 32.
CELL, LEVELS = 4, 3
# Side of a cell of the base, in pixels.
BASE_CELL = 2
# Half the width, in cells, of the two windows on the coarsest grid, and of the window on each
# finer grid. The weight of a cell falls linearly with its distance, to 0 at the window's edge.
COARSE_WINDOWS, FINE_WINDOW = (6, 3), 2
# Weight of all returns of a larger window together, in returns. Larger values smooth more.
LARGER_WINDOW_WEIGHT = 0.3
# Weight of a slope of 0, in returns a cell away. Larger values flatten.
FLAT_WEIGHT = 0.002
# Square of the distance of a cell from the centroid of the returns, in their standard deviations,
# up to which the slope has its full weight. The weight falls to 0 at a value 1 larger. Larger
# values continue slopes farther beyond the returns.
SLOPE_REACH = 2.0
# The result lies between the nearest and the farthest return of a window; this is the side of the
# window, in cells of the coarsest grid.
CLIP_WINDOW = 7
# The nine moments are the sums of 1; r, c, z; rr, cc, rc, zr, zc. r is the distance below a centre,
# c the distance to the right of it, and z the inverse depth. _POWERS has the powers of r and c in
# the moments without z and in the moments with z; _INDICES has the indices of these moments among
# the nine.
_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)), ((0, 0), (1, 0), (0, 1))
_INDICES = (0, 1, 2, 4, 5, 6), (3, 7, 8)
_NUM_MOMENTS = 9
# These avoid divisions by 0: a weight below that of one return in a window, a spread below that of
# any two returns, and an inverse depth below that of any return.
_LEAST_COUNT, _LEAST_SPREAD, _LEAST_INVERSE = 1e-3, 1e-2, 1e-3
# Relative difference of inverse depth up to which a return is on the plane. From twice this
# difference on, the return is on another surface.
MAX_RESIDUAL = 0.15
# Weight of the mean residual of coarser cells, in returns, and the number of coarser grids.
COARSER_RESIDUAL_WEIGHT, RESIDUAL_LEVELS = 0.1, 2


class PlaneFit(NamedTuple):
    """The depth as the returns alone show it.

    Attributes:
        inverse_plane: inverse depth of the planes at the centres of cells of CELL pixels,
            (N, 1, h, w), 0 where no return is in reach of the largest window.
        inverse_base: inverse depth of the base, which is the planes moved to the returns on them,
            on cells of BASE_CELL pixels.
        return_count: number of measured pixels in a cell of BASE_CELL pixels.
    """

    inverse_plane: Tensor
    inverse_base: Tensor
    return_count: Tensor


def fit_base(inverse: Tensor, mask: Tensor, extremes: Tensor) -> PlaneFit:
    """Fit planes, and move them to the returns.

    Args:
        inverse: inverse of the normalised depth, at least 1, (N, 1, H, W), 0 where nothing is
            measured; H and W are multiples of `CELL * 2**LEVELS`.
        mask: 1 where measured, same shape.
        extremes: the greatest inverse depth and the greatest depth in each cell of CELL pixels,
            (N, 2, h, w), 0 where nothing is measured.
    """
    device = inverse.device.type
    if device != "meta" and torch.is_autocast_enabled(device):
        with torch.autocast(device, enabled=False):  # sums of squares need single precision
            return fit_base(inverse, mask, extremes)
    pixels = torch.cat([mask, inverse], dim=1)
    plane = fit_planes(pixels, extremes)
    moments = cell_moments(pixels, BASE_CELL, 4)
    base = add_residuals(upsample(plane, factor=CELL // BASE_CELL), moments)
    return PlaneFit(plane, base, moments[:, :1])


def fit_planes(pixels: Tensor, extremes: Tensor) -> Tensor:
    """Return `PlaneFit.inverse_plane`; pixels: mask and inverse depth, (N, 2, H, W)."""
    grids = [cell_moments(pixels, CELL)]
    for _ in range(LEVELS):
        grids.append(coarser_moments(grids[-1]))
    largest, smaller = COARSE_WINDOWS
    around = window_moments(grids[-1], largest)
    moments = window_moments(grids[-1], smaller) + LARGER_WINDOW_WEIGHT * _per_return(around)
    slope_weight = _slope_weight(torch.cat([around, moments])).unflatten(0, (2, -1)).amax(dim=0)
    for grid in reversed(grids[:-1]):
        moments = window_moments(grid, FINE_WINDOW) + finer_moments(_per_return(moments))
    plane = solve_planes(moments, upsample(slope_weight, factor=2**LEVELS))
    return _clip_to_returns(plane, extremes)


def add_residuals(plane: Tensor, moments: Tensor) -> Tensor:
    """Move planes to the returns on them, by residual interpolation (Kiku et al. 2013).

    The residuals of the returns, which are their differences from the plane, are averaged in a
    window of cells. The mean of coarser cells counts as COARSER_RESIDUAL_WEIGHT returns. Returns of
    other surfaces have no weight, see MAX_RESIDUAL.

    Args:
        plane: inverse depth at the cells' centres, (N, 1, h, w).
        moments: the moments 1, r, c and z of the returns of each cell, (N, 4, h, w), see `_POWERS`.
    """
    count, below, right, total = moments.split(1, dim=1)
    rows = F.pad(plane, (0, 0, 1, 1), mode="replicate")
    columns = F.pad(plane, (1, 1, 0, 0), mode="replicate")
    slopes = (rows[:, :, 2:] - rows[:, :, :-2]) * below
    slopes = slopes + (columns[..., 2:] - columns[..., :-2]) * right
    predicted = plane * count + 0.5 * slopes
    residual = total - predicted
    relative = residual.abs() / predicted.clamp(min=_LEAST_INVERSE)
    weight = hard_sigmoid(relative, -1.0 / MAX_RESIDUAL, 2.0)
    grids = [torch.cat([residual, count], dim=1) * weight]
    for _ in range(RESIDUAL_LEVELS):
        grids.append(cell_means(grids[-1], 2) * 4.0)
    mean: Tensor | None = None
    for grid in reversed(grids):
        total, weight = _tents(grid).split(1, dim=1)
        if mean is not None:
            total = total + COARSER_RESIDUAL_WEIGHT * upsample(mean)
        mean = total / (weight + COARSER_RESIDUAL_WEIGHT)
    assert mean is not None
    return plane + mean


def _tents(x: Tensor) -> Tensor:
    """Sum (1, 2, 1) x (1, 2, 1) / 4 of the 3 x 3 cells around each: two means of 2 x 2."""
    return 4.0 * F.avg_pool2d(F.avg_pool2d(x, 2, 1, 1), 2, 1)


def _per_return(moments: Tensor) -> Tensor:
    """Give all returns of a window together the weight of one return; moments: (N, 9, h, w)."""
    return moments / moments[:, :1].clamp(min=_LEAST_COUNT)


def _slope_weight(moments: Tensor) -> Tensor:
    """Return the weight of both slopes, (N, 2, h, w): 1 between the returns, 0 beyond them.

    Between returns a slope is measured; beyond them it would be extrapolated.
    """
    _, central, shift = _central_moments(moments)
    distance = shift[:, :2] / (central[:, :2] + _LEAST_SPREAD)
    return hard_sigmoid(distance, -1.0, SLOPE_REACH + 1.0)


def _central_moments(moments: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the means of r, c and z; the moments rr, cc, rc, zr, zc about them; the difference.

    The difference is what the moments about the cell's centre have more than the central ones.

    One product computes several channels, so that there are fewer and larger operations.
    """
    count, first, second = moments.split([1, 3, 5], dim=1)
    mean = first / count.clamp(min=_LEAST_COUNT)
    shift = _select(mean, (0, 1, 0, 0, 1)) * _select(first, (0, 1, 1, 2, 2))
    return mean, second - shift, shift


def solve_planes(moments: Tensor, slope_weight: Tensor) -> Tensor:
    """Fit a plane to the returns around each centre: its value there, (N, 1, h, w).

    moments: (N, 9, h, w); slope_weight: the weight of both slopes, see `_slope_weight`.
    """
    mean, central, _ = _central_moments(moments)
    ridge = (FLAT_WEIGHT, FLAT_WEIGHT, 0.0, 0.0, 0.0)
    central = central + central.new_tensor(ridge).view(1, len(ridge), 1, 1)
    # Cramer's rule for the moments rr, cc, rc, zr and zc.
    products = _select(central, (1, 2, 0, 2, 0, 2)) * _select(central, (3, 4, 4, 3, 1, 2))
    numerators, determinant = _convolve(products, _DIFFERENCES).split([2, 1], dim=1)
    slopes = numerators * (slope_weight / determinant)
    centroid, value = mean.split([2, 1], dim=1)
    plane: Tensor = value - (centroid * slopes).sum(dim=1, keepdim=True)
    return plane


# Kernel (3, 6, 1, 1): the difference of each pair of channels.
_DIFFERENCES = np.kron(np.eye(3), [1.0, -1.0]).astype(np.float32)[:, :, None, None]


def _clip_to_returns(plane: Tensor, extremes: Tensor) -> Tensor:
    """Limit the plane to the inverse depths around it, see CLIP_WINDOW."""
    around = window_maxima(cell_maxima(extremes, 2**LEVELS), CLIP_WINDOW)
    nearest, farthest = around.split(1, dim=1)
    least = nearest.clamp(max=1.0) / farthest.clamp(min=_LEAST_INVERSE)  # 0 without returns
    nearest = torch.where(nearest > 0, nearest, torch.inf)
    bounds = torch.cat([least, nearest], dim=1)
    least, nearest = F.interpolate(bounds, scale_factor=float(2**LEVELS), mode="nearest").split(
        1, dim=1
    )
    return torch.minimum(torch.maximum(plane, least), nearest)


def cell_moments(pixels: Tensor, side: int, count: int = _NUM_MOMENTS) -> Tensor:
    """Return the first `count` moments of each cell; pixels as in `fit_planes`."""
    return _convolve(pixels, _cell_kernel(side)[:count], stride=side)


def coarser_moments(moments: Tensor) -> Tensor:
    """Return the moments of cells of twice the width."""
    return _convolve(moments, _coarser_kernel(), stride=2)


def window_moments(moments: Tensor, window: int) -> Tensor:
    """Return the moments of a window about each cell: a tent of half the width `window`."""
    return _convolve(moments, _window_kernel(window), padding=window - 1)


def finer_moments(moments: Tensor) -> Tensor:
    """Return the moments about the centres of finer cells, times LARGER_WINDOW_WEIGHT.

    A finer cell has half the width. Its moments are sums over the four closest cells, with bilinear
    weights.
    """
    kernel = torch.from_numpy(_finer_kernel()).to(moments)
    return F.conv_transpose2d(moments, kernel, stride=2, padding=1)


def _select(x: Tensor, channels: tuple[int, ...]) -> Tensor:
    return x.index_select(1, torch.tensor(channels, device=x.device))


def _convolve(
    x: Tensor, kernel: NDArray[np.float32], *, stride: int = 1, padding: int = 0
) -> Tensor:
    return F.conv2d(x, torch.from_numpy(kernel).to(x), stride=stride, padding=padding)


@cache
def _cell_kernel(side: int) -> NDArray[np.float32]:
    """Kernel (9, 2, side, side): mask and inverse depth of pixels to the moments of their cell."""
    coordinate = (np.arange(side) + 0.5) / side - 0.5
    kernel = np.zeros((_NUM_MOMENTS, 2, side, side), np.float32)
    for channel, (powers, indices) in enumerate(zip(_POWERS, _INDICES, strict=True)):
        for (down, right), index in zip(powers, indices, strict=True):
            kernel[index, channel] = coordinate[:, None] ** down * coordinate[None, :] ** right
    return kernel


@cache
def _coarser_kernel() -> NDArray[np.float32]:
    """Kernel (9, 9, 2, 2): the moments of four cells to those of the cell that they make up."""
    kernel = np.zeros((_NUM_MOMENTS, _NUM_MOMENTS, 2, 2), np.float32)
    for row, column in np.ndindex(2, 2):
        kernel[:, :, row, column] = _translation((row - 0.5) / 2, (column - 0.5) / 2, scale=0.5)
    return kernel


@cache
def _finer_kernel() -> NDArray[np.float32]:
    """Kernel (9, 9, 4, 4) of a transposed convolution: a cell's moments to those of finer cells."""
    kernel = np.zeros((_NUM_MOMENTS, _NUM_MOMENTS, 4, 4), np.float32)
    for row, column in np.ndindex(4, 4):
        down, right = 1.5 - row, 1.5 - column  # from the finer cell's centre to the cell's
        weight = LARGER_WINDOW_WEIGHT * (1 - abs(down) / 2) * (1 - abs(right) / 2)
        kernel[:, :, row, column] = weight * _translation(down, right, scale=2.0).T
    return kernel


@cache
def _window_kernel(window: int) -> NDArray[np.float32]:
    """Kernel (9, 9, 2 w - 1, 2 w - 1): the moments of a window w about its centre cell."""
    side = 2 * window - 1
    kernel = np.zeros((_NUM_MOMENTS, _NUM_MOMENTS, side, side), np.float32)
    for row, column in np.ndindex(side, side):
        down, right = row - window + 1, column - window + 1
        weight = (1 - abs(down) / window) * (1 - abs(right) / window)
        kernel[:, :, row, column] = weight * _translation(down, right)
    return kernel


def _translation(down: float, right: float, *, scale: float = 1.0) -> NDArray[Any]:
    """Return the matrix (9, 9) from moments about one centre to moments about another.

    A position p relative to the old centre is `scale * p + (down, right)` relative to the new
    one; its powers follow from the binomial theorem.
    """
    matrix = np.zeros((_NUM_MOMENTS, _NUM_MOMENTS))
    for powers, indices in zip(_POWERS, _INDICES, strict=True):
        for new, row in zip(powers, indices, strict=True):
            for old, column in zip(powers, indices, strict=True):
                matrix[row, column] = np.prod(
                    [
                        math.comb(power, kept) * scale**kept * offset ** (power - kept)
                        if kept <= power
                        else 0.0
                        for power, kept, offset in zip(new, old, (down, right), strict=True)
                    ]
                )
    return matrix
