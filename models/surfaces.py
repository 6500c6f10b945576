"""Dense depth from sparse depth by choosing among surfaces that were measured.

A mean of 5 m and 80 m is the depth of no surface. Three candidates are therefore kept apart around
each pixel: the nearest surface, the farthest, and the mean of inverse depth. The network chooses
among them on a grid. At the image's size each return then replaces the chosen depth of the pixels
around it, weighted by the network's confidence in it.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import extend_to_multiple
from models.pooling import cell_maxima, maxima_around, maxima_beside, means_around
from models.pull_push import pull_push

#: Side of a cell in pixels: of the coarse grid, where surfaces are propagated, and of the fine one.
COARSE_CELL, FINE_CELL = 4, 2
#: Windows of the max-pools that propagate a surface into cells without any, one after the other:
#: together they reach 10 cells.
WINDOWS = (3, 5, 7, 9)
#: Least normalised depth of a surface.
NEAREST = 1e-3
_LOG_NEAREST = -6.907755  # log(NEAREST)
#: A return within this share of the predicted depth replaces it whatever the confidence; beyond
#: twice as much the confidence alone decides: it may show through the gap between two surfaces.
AGREEMENT = 0.05
#: A return up to this many times as far as a surface, or as near, belongs to it.
SAME_SURFACE = 1.25
#: Least and greatest log of the ratio of the error's scale to the depth.
LOG_SCALE = (-6.0, 1.0)
#: Returns that no other confirms, see `drop_isolated`: within this depth [m], with returns in so
#: many cells around, all of them more than so many times as far.
ISOLATED_M, ISOLATED_CELLS, ISOLATED_RATIO = 10.0, 8, 3.0
#: Channels of `surface_features`.
FEATURE_CHANNELS = 6
#: Radius [pixels] of the square around a return in which it may replace the depth.
RETURN_REACH = 2
#: Largest share by which a return beside a pixel reduces the error's scale.
MAX_SCALE_REDUCTION = 0.9
#: Channels that `choose_surface`, `error_scale` and `return_confidence` read.
HEAD_CHANNELS = 8


class Returns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W)."""

    #: Normalised depth of the closest return; of several as close, of the one in front. Undefined
    #: where ``near`` is 0.
    depth: Tensor
    #: 1 where a return is within RETURN_REACH.
    near: Tensor
    #: 1 where a return is at the pixel itself.
    here: Tensor


class Surfaces(NamedTuple):
    """Candidates of the normalised depth, each (N, 1, h, w), NEAREST..1, and where there are any.

    ``nearest`` and ``farthest`` are undefined where ``support`` (0..1) is 0, ``mean`` where
    ``mean_support`` (0..1) is 0.
    """

    nearest: Tensor
    farthest: Tensor
    mean: Tensor
    support: Tensor
    mean_support: Tensor


def drop_isolated(
    depth: Tensor, valid_mask: Tensor, *, max_depth_m: float
) -> tuple[Tensor, Tensor]:
    """Drop near returns that no other return confirms: rain, snow, dust, crosstalk.

    A return within ISOLATED_M is dropped if at least ISOLATED_CELLS of the 24 cells of
    COARSE_CELL pixels around its own have returns, and all these are more than ISOLATED_RATIO times
    as far: whatever stands so close covers more than one cell. As the dynamic radius outlier
    removal of Charron et al. 2018, on the image's grid: the farther, the smaller a thing may be.

    depth (N, 1, H, W): normalised by ``max_depth_m``, 0 = none; valid_mask: bool. Returns both
    without such returns.
    """
    measured = torch.cat([depth, valid_mask.to(depth.dtype)], dim=1)
    inverse = _inverse(measured)
    cells = cell_maxima(extend_to_multiple(inverse, COARSE_CELL), COARSE_CELL)
    seen = (cells > 0).to(cells.dtype)
    count = 25.0 * means_around(seen, 5) - seen
    # Inverse depth beyond which a return stands alone in its cell.
    most = torch.where(
        count > ISOLATED_CELLS - 0.5,
        (ISOLATED_RATIO * maxima_beside(cells)).clamp(min=max_depth_m / ISOLATED_M),
        1.0 / NEAREST,
    )
    most = F.interpolate(most, scale_factor=float(COARSE_CELL), mode="nearest")
    kept = inverse <= most[..., : depth.shape[2], : depth.shape[3]]
    return torch.where(kept, depth, 0.0), valid_mask & kept


def propagate_surfaces(measured: Tensor, *, levels: int) -> tuple[Surfaces, Tensor]:
    """Propagate the measured depth to a grid of cells of COARSE_CELL pixels.

    measured (N, 2, H, W): the normalised depth, 0 where not measured, and the mask of measured
    pixels, 0 or 1; height and width are multiples of ``COARSE_CELL * 2**levels``. The nearest
    surface is the maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of
    depth, both as far as WINDOWS reach; the mean is a pull-push pyramid of inverse depth, which
    reaches as far as its ``levels``. Returns the surfaces, and the share of measured pixels in a
    cell, (N, 1, h, w).
    """
    depth, mask, inverse = measured[:, :1], measured[:, 1:], _inverse(measured)
    propagated = cell_maxima(torch.cat([inverse, depth], dim=1), COARSE_CELL)
    for window in WINDOWS:
        propagated = torch.where(propagated > 0, propagated, maxima_around(propagated, window))
    support = (propagated[:, 1:] > 0).to(depth.dtype)
    smooth = means_around(torch.cat([propagated[:, :1], support], dim=1), 3)
    nearest = smooth[:, 1:].clamp(min=1e-6) / smooth[:, :1].clamp(min=1e-6)

    mean, density = pull_push(torch.cat([inverse, mask], dim=1), factor=COARSE_CELL, levels=levels)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        propagated[:, 1:].clamp(NEAREST, 1.0),
        (mean[:, 1:].clamp(min=1e-6) / mean[:, :1].clamp(min=1e-6)).clamp(NEAREST, 1.0),
        support,
        mean[:, 1:],
    )
    return surfaces, density


def surface_features(surfaces: Surfaces, density: Tensor) -> Tensor:
    """Features for a convolution: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, surfaces.mean], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.mean_support], dim=1)
    steps = (1.0 - torch.log(depths) * (1.0 / _LOG_NEAREST)) * known
    return torch.cat([steps, surfaces.support, surfaces.mean_support, density], dim=1)


def refine_surfaces(upsampled: Surfaces, measured: Tensor) -> Surfaces:
    """Replace the propagated surfaces by the measured ones in cells of FINE_CELL pixels.

    A return replaces only the surface that it belongs to: a LiDAR beside the camera sees past near
    edges, and a return from behind one would tear it. upsampled: the coarse surfaces on the fine
    grid. measured: as in `propagate_surfaces`.
    """
    depth, mask = measured[:, :1], measured[:, 1:]
    # The nearest as a maximum of mask - depth: cells without a measurement come last.
    fine = cell_maxima(torch.cat([mask - depth, depth], dim=1), FINE_CELL)
    seen = fine[:, 1:] > 0
    nearest = (1.0 - fine[:, :1]).clamp(min=NEAREST)
    farthest = fine[:, 1:].clamp(min=NEAREST)
    between = torch.sqrt(upsampled.nearest * upsampled.farthest)
    on_near = nearest < torch.maximum(between, SAME_SURFACE * upsampled.nearest)
    on_far = farthest > torch.minimum(between, upsampled.farthest * (1.0 / SAME_SURFACE))
    return upsampled._replace(
        nearest=torch.where(seen & on_near, nearest, upsampled.nearest),
        farthest=torch.where(seen & on_far, farthest, upsampled.farthest),
    )


def choose_surface(
    head: Tensor, regressed: Tensor, surfaces: Surfaces, *, reach: float = 1.0
) -> Tensor:
    """Normalised depth (N, 1, h, w), NEAREST..1, from the candidates and the regressed depth.

    head (N, HEAD_CHANNELS, h, w): logits of the confidence in the mean, the farthest and the
    nearest surface, and a relative correction. Each in turn replaces the depth chosen before,
    weighted by its confidence: nested sigmoids give any weights that a soft-max can. Without
    support the regressed depth remains. No depth is beyond ``reach``, that of the regression,
    unless the farthest surface is.
    """
    confidence = torch.sigmoid(head[:, :3])
    depth = regressed + confidence[:, :1] * surfaces.mean_support * (surfaces.mean - regressed)
    depth = depth + confidence[:, 1:2] * surfaces.support * (surfaces.farthest - depth)
    depth = depth + confidence[:, 2:3] * surfaces.support * (surfaces.nearest - depth)
    depth = (depth * torch.exp(0.5 * torch.tanh(head[:, 3:4]))).clamp(min=NEAREST)
    return torch.minimum(depth, (surfaces.farthest * surfaces.support).clamp(min=reach))


def error_scale(head: Tensor, depth: Tensor) -> Tensor:
    """Scale of the error's Laplace distribution (N, 1, h, w), normalised as the depth is.

    The fifth channel of the head is the logit of the log of the scale's ratio to the depth, between
    the bounds of LOG_SCALE.
    """
    least, greatest = LOG_SCALE
    return depth * torch.exp(least + (greatest - least) * torch.sigmoid(head[:, 4:5]))


def return_confidence(head: Tensor) -> Tensor:
    """The head's last channels, about the returns beside a pixel: (N, 3, h, w), 0..1.

    The confidence in a return before the predicted depth and in one behind it, see `take_returns`,
    and the reduction of the error's scale, see `reduce_scale`.
    """
    return torch.sigmoid(head[:, 5:8])


def dilate_returns(measured: Tensor) -> Returns:
    """Dilate the returns by RETURN_REACH pixels; measured: as in `propagate_surfaces`."""
    inverse = _inverse(measured)
    for _ in range(RETURN_REACH):
        inverse = torch.where(inverse > 0, inverse, maxima_around(inverse, 3))
    near = (inverse > 0).to(inverse.dtype)
    return Returns(1.0 / inverse.clamp(min=1.0), near, measured[:, 1:])


def take_returns(depth: Tensor, returns: Returns, before: Tensor, behind: Tensor) -> Tensor:
    """Replace the predicted depth by the closest return, weighted by the confidence in it.

    At an edge the choice on a coarser grid is a ramp; a return is on one side of it. A LiDAR beside
    the camera sees past near edges, so returns before and behind the predicted depth have
    confidences of their own. A return at the pixel itself that agrees replaces it in any case.

    All (N, 1, H, W), depth normalised; before, behind: 0..1, the confidence in a return before the
    predicted depth, and in one behind it.
    """
    step = (returns.depth - depth) * returns.near
    taken = before * step.clamp(max=0.0) + behind * step.clamp(min=0.0)
    agrees = (2.0 - step.abs() / depth * (1.0 / AGREEMENT)).clamp(0.0, 1.0) * returns.here
    return depth + taken + agrees * (step - taken)


def reduce_scale(scale: Tensor, returns: Returns, reduction: Tensor) -> Tensor:
    """Reduce the error's scale near returns by a share of MAX_SCALE_REDUCTION; all (N, 1, H, W)."""
    return scale * (1.0 - MAX_SCALE_REDUCTION * reduction * returns.near)


def _inverse(measured: Tensor) -> Tensor:
    """Inverse of the normalised depth, 1..1/NEAREST, 0 where not measured."""
    return measured[:, 1:] / measured[:, :1].clamp(min=NEAREST)
