"""Candidates of the depth: what the returns alone show, without a parameter that is trained.

Each cell of a grid has the nearest and the farthest surface around it and the plane between the
returns, because the mean of 5 m and 80 m is the depth of no surface. The base (`models.planes`)
passes through the returns on a finer grid. At the image's size the returns are dilated.
`models.surface_depth` decides among the candidates. Keeping near and far surfaces apart resembles
twin surface extrapolation (Imran et al. 2021).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import ramp
from models.planes import BASE_CELL, CELL, Base, fit_base
from models.pooling import cell_maxima, cell_means, maxima_around, maxima_beside, means_around

# Least normalised depth of a surface.
NEAREST = 1e-3


class Measured(NamedTuple):
    """The measured depth at the image's size, all (N, 1, H, W), each 0 where nothing is measured.

    Height and width are multiples of `planes.CELL * 2**planes.LEVELS`.

    Attributes:
        depth: normalised depth.
        mask: 1 where measured.
        inverse: inverse of the normalised depth, 1..1/NEAREST.
    """

    depth: Tensor
    mask: Tensor
    inverse: Tensor


class Surfaces(NamedTuple):
    """Candidates on a grid, and the cells that have any, each (N, 1, h, w).

    Attributes:
        nearest, farthest: normalised depth, NEAREST..1, of the nearest and the farthest surface;
            undefined where `support` is 0.
        plane: inverse of the normalised depth, 1..1/NEAREST; undefined where `reached` is 0.
        support: 1 where a return is within reach of WINDOWS; between 0 and 1 after upsampling.
        reached: 1 where a return is within reach of the plane's windows; otherwise as `support`.
    """

    nearest: Tensor
    farthest: Tensor
    plane: Tensor
    support: Tensor
    reached: Tensor


class Beside(NamedTuple):
    """What decides the depth close to returns, each (N, 1, h, w) on the grid of CELL.

    Attributes:
        near: log ratio of the nearest surface to the base, -MOST_APART..0.
        far: log ratio of the farthest surface to the base, 0..MOST_APART.
        share: share of the base: MOST_BESIDE up to about 2 pixels from a return, 0 beyond about 5.
    """

    near: Tensor
    far: Tensor
    share: Tensor


class Candidates(NamedTuple):
    """All candidates of a frame.

    Attributes:
        measured: what is measured.
        surfaces: the nearest surface, the farthest one, and the plane.
        base: the planes moved to the returns on them.
        beside: what decides the depth close to returns.
        features: (N, FEATURE_CHANNELS, h, w), on the grid of CELL.
        guess_limit: greatest normalised depth of the guess from the image, (N, 1, h, w), see
            `limit_guess`.
    """

    measured: Measured
    surfaces: Surfaces
    base: Base
    beside: Beside
    features: Tensor
    guess_limit: Tensor


def find_candidates(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> Candidates:
    """Return the candidates of a frame; the arguments are those of `measure`."""
    measured = measure(depth, mask, max_depth_m=max_depth_m)
    surfaces, base, count = propagate_surfaces(measured)
    features, limit = surface_features(surfaces, count), limit_guess(surfaces, count)
    return Candidates(measured, surfaces, base, look_beside(surfaces, base), features, limit)


# A return is isolated if it is within ISOLATED_M [m], at least ISOLATED_CELLS of the cells around
# have returns, and all of these are more than ISOLATED_RATIO times as far, see `measure`.
ISOLATED_M, ISOLATED_CELLS, ISOLATED_RATIO = 10.0, 8, 3.0


def measure(depth: Tensor, mask: Tensor, *, max_depth_m: float) -> Measured:
    """Drop near returns that no other return confirms: rain, snow, dust.

    A return within ISOLATED_M is dropped if at least ISOLATED_CELLS of the 24 cells of CELL pixels
    around its own have returns, and all of these are more than ISOLATED_RATIO times as far: an
    object so close covers more than one cell. It is the dynamic radius outlier removal of Charron
    et al. 2018 on the image's grid: the farther an object, the smaller it may be.

    Args:
        depth: normalised by `max_depth_m`, (N, 1, H, W), see `Measured`.
        mask: 1 where measured, same shape.
        max_depth_m: depth of 1.0.
    """
    inverse = mask / depth.clamp(min=NEAREST)
    cells = cell_maxima(inverse, CELL)
    seen = cells.clamp(max=1.0)  # an inverse depth is at least 1
    count = 25.0 * means_around(seen, 5) - seen
    # Inverse depth beyond which a return is isolated.
    most = torch.where(
        count > ISOLATED_CELLS - 0.5,
        (ISOLATED_RATIO * maxima_beside(cells)).clamp(min=max_depth_m / ISOLATED_M),
        1.0 / NEAREST,
    )
    most = F.interpolate(most, scale_factor=float(CELL), mode="nearest")
    kept = (inverse <= most).to(mask.dtype)
    return Measured(depth * kept, mask * kept, inverse * kept)


# Windows of the max-pools that propagate a surface into cells without any, one after the other:
# together they reach 10 cells.
WINDOWS = (3, 5, 7, 9)


def propagate_surfaces(measured: Measured) -> tuple[Surfaces, Base, Tensor]:
    """Propagate the measured depth to a grid of cells of CELL pixels.

    The nearest surface is the maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the
    maximum of depth.

    Returns:
        The surfaces; the base; and the number of measured pixels in a cell, (N, 1, h, w).
    """
    depth, mask, inverse = measured
    extremes = cell_maxima(torch.cat([inverse, depth], dim=1), CELL)
    both = extremes
    for window in WINDOWS:
        both = torch.where(both > 0, both, maxima_around(both, window))
    near, farthest = both.split(1, dim=1)
    support = near.clamp(max=1.0)  # an inverse depth is at least 1
    inverse_mean, known = means_around(torch.cat([near, support], dim=1), 3).split(1, dim=1)
    nearest = known.clamp(min=1e-6) / inverse_mean.clamp(min=1e-6)
    base = fit_base(inverse, mask, extremes)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        farthest.clamp(NEAREST, 1.0),
        base.plane.clamp(1.0, 1.0 / NEAREST),
        support,
        base.plane.clamp(max=1.0),
    )
    base = base._replace(base=base.base.clamp(1.0, 1.0 / NEAREST))
    return surfaces, base, 4.0 * cell_means(base.returns, CELL // BASE_CELL)


# Channels of `surface_features`.
FEATURE_CHANNELS = 6


def surface_features(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Features for a convolution: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, 1.0 / surfaces.plane], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.reached], dim=1)
    steps = (1.0 - torch.log(depths) * (1.0 / math.log(NEAREST))) * known
    density = count * (1.0 / CELL**2)
    return torch.cat([steps, surfaces.support, surfaces.reached, density], dim=1)


# A cell is within the LiDAR's field of view if there is a return up to this number of cells above
# it and to each side. Larger values limit the guess in the sky above the scan, too.
LOOKED_ABOVE, LOOKED_BESIDE = 10, 2


def limit_guess(surfaces: Surfaces, count: Tensor) -> Tensor:
    """Return the greatest depth that the guess from the image may have: the farthest surface's.

    A surface without returns, such as a black car or a window, hides the surfaces behind it. Above
    the LiDAR's field of view there is no limit. The shapes are those of `surface_features`.
    """
    window = (LOOKED_ABOVE + 1, 2 * LOOKED_BESIDE + 1)
    padded = F.pad(count, (LOOKED_BESIDE, LOOKED_BESIDE, LOOKED_ABOVE, 0))
    looked = F.max_pool2d(padded, window, 1).clamp(max=1.0) * surfaces.support
    return 1.0 - looked * (1.0 - surfaces.farthest)


# Log ratio of a surface to the base up to which they are one surface. From twice this ratio on
# they are two surfaces.
APART = 0.08
# Greatest log ratio of a surface to the base.
MOST_APART = 2.5
# Largest share of the base. The choice from the image keeps the rest: the mean of both has a
# smaller error than either.
MOST_BESIDE = 0.5


def look_beside(surfaces: Surfaces, base: Base) -> Beside:
    """Compare the surfaces with the base."""
    seen = base.returns.clamp(max=1.0)
    share = (MOST_BESIDE / 2) * (maxima_around(seen, 3) + maxima_around(seen, 5))
    maps = cell_means(torch.cat([base.base, share], dim=1), CELL // BASE_CELL)
    inverse, share = maps.split(1, dim=1)
    near = torch.log(surfaces.nearest * inverse).clamp(-MOST_APART, 0.0)
    far = torch.log(surfaces.farthest * inverse).clamp(0.0, MOST_APART)
    return Beside(near * surfaces.support, far * surfaces.support, share)


def apart(log_ratio: Tensor) -> Tensor:
    """Return 0 for one surface, the log ratio itself for two, see APART."""
    return log_ratio * ramp(log_ratio.abs(), 1.0 / APART, -1.0)


# Radius [pixels] of the square around a return in which it may replace the depth.
RETURN_REACH = 2


class Returns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W).

    Attributes:
        inverse: inverse of the normalised depth of the closest return. Of several returns at the
            same distance the nearest to the camera is used. 1 where `near` is 0.
        near: 1 where a return is within RETURN_REACH.
        here: 1 where a return is at the pixel itself.
    """

    inverse: Tensor
    near: Tensor
    here: Tensor


def dilate_returns(measured: Measured) -> Returns:
    """Dilate the returns by RETURN_REACH pixels."""
    inverse, near = measured.inverse, measured.mask
    for _ in range(RETURN_REACH):
        inverse = inverse + (1.0 - near) * maxima_around(inverse, 3)
        near = inverse.clamp(max=1.0)  # an inverse depth is at least 1
    return Returns(inverse.clamp(min=1.0), near, measured.mask)
