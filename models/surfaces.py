"""Candidates of the depth: what the returns alone show, without a parameter that is trained.

Each cell of a grid has the nearest and the farthest surface around it and the plane between the
returns, because the mean of 5 m and 80 m is the depth of no surface. The base (`models.planes`)
passes through the returns on a finer grid. At the image's size the returns are dilated.
`models.surface_depth` decides among the candidates.

The paper has no candidates: its depth decoder regresses the depth (section 2.1.3), which blurs the
edges between surfaces. Keeping near and far surfaces apart resembles twin surface extrapolation
(Imran et al. 2021).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import hard_sigmoid, upsample_nearest
from models.planes import BASE_CELL, CELL, PlaneFit, fit_base
from models.pooling import (
    cell_maxima,
    cell_means,
    neighbour_maxima,
    window_maxima,
    window_means,
)

# Least normalised depth of a surface.
MIN_DEPTH = 1e-3


class SparseDepth(NamedTuple):
    """The returns at the image's size, all (N, 1, H, W), each 0 where there is no return.

    Height and width are multiples of `planes.CELL * 2**planes.LEVELS`.

    Attributes:
        depth: normalised depth.
        mask: 1 where there is a return.
        inverse: inverse of the normalised depth, 1..1/MIN_DEPTH.
    """

    depth: Tensor
    mask: Tensor
    inverse: Tensor


class Surfaces(NamedTuple):
    """Candidate surfaces on a grid, and the cells that have any, each (N, 1, h, w).

    Attributes:
        nearest, farthest: normalised depth, MIN_DEPTH..1, of the nearest and the farthest surface;
            undefined where `support` is 0.
        inverse_plane: inverse of the normalised depth of the plane between the returns,
            1..1/MIN_DEPTH; undefined where `plane_support` is 0.
        support: 1 where a return is within reach of DILATION_WINDOWS; between 0 and 1 after
            upsampling.
        plane_support: 1 where a return is within reach of the plane's windows; otherwise as
            `support`.
    """

    nearest: Tensor
    farthest: Tensor
    inverse_plane: Tensor
    support: Tensor
    plane_support: Tensor


class BaseRatios(NamedTuple):
    """How both surfaces differ from the base, each (N, 1, h, w) on the grid of CELL.

    Attributes:
        nearest: log ratio of the nearest surface to the base, -MAX_LOG_RATIO..0.
        farthest: log ratio of the farthest surface to the base, 0..MAX_LOG_RATIO.
        base_weight: weight of the base in the depth: MAX_BASE_WEIGHT up to about 2 pixels from a
            return, 0 beyond about 5.
    """

    nearest: Tensor
    farthest: Tensor
    base_weight: Tensor


class Candidates(NamedTuple):
    """All candidates of a frame.

    Attributes:
        sparse_depth: the returns without outliers.
        surfaces: the nearest surface, the farthest one, and the plane.
        inverse_base: see `PlaneFit`.
        near_returns: see `find_near_returns`.
        base_ratios: how both surfaces differ from the base.
        features: (N, FEATURE_CHANNELS, h, w), on the grid of CELL.
        monocular_limit: greatest normalised depth that may be predicted from the image alone,
            (N, 1, h, w), see `limit_monocular`.
    """

    sparse_depth: SparseDepth
    surfaces: Surfaces
    inverse_base: Tensor
    near_returns: Tensor
    base_ratios: BaseRatios
    features: Tensor
    monocular_limit: Tensor


def find_candidates(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> Candidates:
    """Return the candidates of a frame; the arguments are those of `remove_outliers`."""
    sparse_depth = remove_outliers(depth, mask, max_depth_m=max_depth_m)
    surfaces, fit = propagate_surfaces(sparse_depth)
    count = count_returns(fit)
    features, limit = surface_features(surfaces, count), limit_monocular(surfaces, count)
    near, ratios = find_near_returns(fit), compare_with_base(surfaces, fit)
    return Candidates(sparse_depth, surfaces, fit.inverse_base, near, ratios, features, limit)


# A return is an outlier if it is within OUTLIER_M [m], at least OUTLIER_CELLS of the cells around
# have returns, and all of these are more than OUTLIER_RATIO times as far, see `remove_outliers`.
OUTLIER_M, OUTLIER_CELLS, OUTLIER_RATIO = 10.0, 8, 3.0


def remove_outliers(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> SparseDepth:
    """Drop near returns that no other return confirms: rain, snow, dust.

    A return within OUTLIER_M is dropped if at least OUTLIER_CELLS of the 24 cells of CELL pixels
    around its own have returns, and all of these are more than OUTLIER_RATIO times as far: an
    object so close covers more than one cell. It is the dynamic radius outlier removal of Charron
    et al. 2018 on the image's grid: the farther an object, the smaller it may be.

    Args:
        depth: normalised by `max_depth_m`, (N, 1, H, W), see `SparseDepth`.
        mask: 1 where there is a return, same shape.
        max_depth_m: depth of 1.0.
    """
    inverse = mask / depth.clamp(min=MIN_DEPTH)
    cells = cell_maxima(inverse, CELL)
    occupied = cells.clamp(max=1.0)  # an inverse depth is at least 1
    count = 25.0 * window_means(occupied, 5) - occupied
    # Inverse depth beyond which a return is an outlier.
    limit = torch.where(
        count > OUTLIER_CELLS - 0.5,
        (OUTLIER_RATIO * neighbour_maxima(cells)).clamp(min=max_depth_m / OUTLIER_M),
        1.0 / MIN_DEPTH,
    )
    kept = (inverse <= upsample_nearest(limit, CELL)).to(mask.dtype)
    return SparseDepth(depth * kept, mask * kept, inverse * kept)


# Windows of the max-pools that propagate a surface into cells without any, one after the other:
# together they reach 10 cells.
DILATION_WINDOWS = (3, 5, 7, 9)


def propagate_surfaces(sparse_depth: SparseDepth) -> tuple[Surfaces, PlaneFit]:
    """Propagate the returns to a grid of cells of CELL pixels.

    The nearest surface is the maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the
    maximum of depth.
    """
    depth, mask, inverse = sparse_depth
    extremes = cell_maxima(torch.cat([inverse, depth], dim=1), CELL)
    dilated = extremes
    for window in DILATION_WINDOWS:
        dilated = torch.where(dilated > 0, dilated, window_maxima(dilated, window))
    inverse_nearest, farthest = dilated.split(1, dim=1)
    support = inverse_nearest.clamp(max=1.0)  # an inverse depth is at least 1
    maps = window_means(torch.cat([inverse_nearest, support], dim=1), 3)
    inverse_mean, supported = maps.split(1, dim=1)
    nearest = supported.clamp(min=1e-6) / inverse_mean.clamp(min=1e-6)
    fit = fit_base(inverse, mask, extremes)
    surfaces = Surfaces(
        nearest.clamp(MIN_DEPTH, 1.0),
        farthest.clamp(MIN_DEPTH, 1.0),
        fit.inverse_plane.clamp(1.0, 1.0 / MIN_DEPTH),
        support,
        fit.inverse_plane.clamp(max=1.0),
    )
    return surfaces, fit._replace(inverse_base=fit.inverse_base.clamp(1.0, 1.0 / MIN_DEPTH))


def count_returns(fit: PlaneFit) -> Tensor:
    """Return the number of returns in each cell of CELL pixels, (N, 1, h, w)."""
    side = CELL // BASE_CELL
    return float(side**2) * cell_means(fit.return_count, side)


# Channels of `surface_features`.
FEATURE_CHANNELS = 6


def surface_features(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Features for a convolution: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, 1.0 / surfaces.inverse_plane], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.plane_support], dim=1)
    log_depths = (1.0 - torch.log(depths) * (1.0 / math.log(MIN_DEPTH))) * known
    density = count * (1.0 / CELL**2)
    return torch.cat([log_depths, surfaces.support, surfaces.plane_support, density], dim=1)


# A cell is within the LiDAR's field of view if there is a return up to this number of cells above
# it and to each side. Larger values limit the monocular depth in the sky above the scan, too.
VIEW_ABOVE, VIEW_BESIDE = 10, 2


def limit_monocular(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Return the greatest depth that may be predicted from the image: the farthest surface's.

    A surface without returns, such as a black car or a window, hides the surfaces behind it. Above
    the LiDAR's field of view there is no limit. The shapes are those of `surface_features`.
    """
    window = (VIEW_ABOVE + 1, 2 * VIEW_BESIDE + 1)
    padded = F.pad(count, (VIEW_BESIDE, VIEW_BESIDE, VIEW_ABOVE, 0))
    in_view = F.max_pool2d(padded, window, 1).clamp(max=1.0) * surfaces.support
    return 1.0 - in_view * (1.0 - surfaces.farthest)


# Log ratio of a surface to the base up to which they are one surface. From twice this ratio on
# they are two surfaces.
SAME_SURFACE = 0.08
# Greatest log ratio of a surface to the base.
MAX_LOG_RATIO = 2.5
# Largest weight of the base. The choice from the image keeps the rest: the mean of both has a
# smaller error than either.
MAX_BASE_WEIGHT = 0.5


def compare_with_base(surfaces: Surfaces, fit: PlaneFit) -> BaseRatios:
    """Compare the surfaces with the base."""
    near = find_near_returns(fit)
    weight = (MAX_BASE_WEIGHT / 2) * (near + window_maxima(near, 3))
    maps = cell_means(torch.cat([fit.inverse_base, weight], dim=1), CELL // BASE_CELL)
    inverse_base, weight = maps.split(1, dim=1)
    nearest = torch.log(surfaces.nearest * inverse_base).clamp(-MAX_LOG_RATIO, 0.0)
    farthest = torch.log(surfaces.farthest * inverse_base).clamp(0.0, MAX_LOG_RATIO)
    return BaseRatios(nearest * surfaces.support, farthest * surfaces.support, weight)


def find_near_returns(fit: PlaneFit) -> Tensor:
    """Return 1 for cells of BASE_CELL pixels within RETURN_RADIUS of a return, (N, 1, h, w)."""
    return window_maxima(fit.return_count.clamp(max=1.0), 1 + 2 * (RETURN_RADIUS // BASE_CELL))


def zero_if_same_surface(log_ratio: Tensor) -> Tensor:
    """Return 0 for one surface, the log ratio itself for two, see SAME_SURFACE."""
    return log_ratio * hard_sigmoid(log_ratio.abs(), 1.0 / SAME_SURFACE, -1.0)


# Radius [pixels] of the square around a return in which it may replace the depth.
RETURN_RADIUS = 2


class DilatedReturns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W).

    Attributes:
        inverse: inverse of the normalised depth of the closest return. Of several returns at the
            same distance the nearest to the camera is used. 1 where `mask` is 0.
        mask: 1 where a return is within RETURN_RADIUS.
        at_pixel: 1 where a return is at the pixel itself.
    """

    inverse: Tensor
    mask: Tensor
    at_pixel: Tensor


def dilate_returns(sparse_depth: SparseDepth) -> DilatedReturns:
    """Dilate the returns by RETURN_RADIUS pixels."""
    inverse, mask = sparse_depth.inverse, sparse_depth.mask
    for _ in range(RETURN_RADIUS):
        inverse = inverse + (1.0 - mask) * window_maxima(inverse, 3)
        mask = inverse.clamp(max=1.0)  # an inverse depth is at least 1
    return DilatedReturns(inverse.clamp(min=1.0), mask, sparse_depth.mask)
