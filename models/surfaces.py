"""Dense depth from sparse depth by choosing among surfaces that were measured.

A mean of 5 m and 80 m is a surface that is nowhere. What was measured around a pixel is kept apart
instead, as the nearest surface, the farthest and the mean of inverse depth, and the network says
which of them a pixel shows. That is done on a grid; at the picture's own size a return then takes
the place of what was chosen for the pixels around it, as far as the network trusts it there.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from models.pooling import cell_maxima, maxima_around, means_around
from models.pull_push import pull_push

#: Pixels a side of a cell on the coarse grid, where surfaces are carried on, and on the fine one.
COARSE_CELL, FINE_CELL = 4, 2
#: Windows of the max-pools that carry a surface on into cells without any, one after the other:
#: together they reach 10 cells.
WINDOWS = (3, 5, 7, 9)
#: Normalised depth below which no surface lies.
NEAREST = 1e-3
_LOG_NEAREST = -6.907755  # log(NEAREST)
#: A return within this share of the predicted depth is taken as it is, whatever the trust; beyond
#: twice as much the trust alone decides: it may show through the gap between two surfaces.
AGREEMENT = 0.05
#: A return up to this many times as far as a surface, or as near, lies on it.
SAME_SURFACE = 1.25
#: Least and greatest log of the ratio of the error's scale to the depth.
LOG_SCALE = (-6.0, 1.0)
#: What `surface_features` gives.
FEATURE_CHANNELS = 6
#: Pixels, in squares around it, that a return may stand for.
RETURN_REACH = 2
#: Share of the error's scale that a return beside a pixel can take away.
MOST_SURER = 0.9
#: What `choose_surface`, `error_scale` and `return_trust` read.
HEAD_CHANNELS = 8


class Returns(NamedTuple):
    """The returns around each pixel, all (N, 1, H, W).

    Normalised depth of the nearest one, of several as near of the one in front; 1 where it is
    within RETURN_REACH (elsewhere the depth says nothing); 1 where it is at the pixel itself.
    """

    depth: Tensor
    near: Tensor
    here: Tensor


class Surfaces(NamedTuple):
    """Candidates of the normalised depth, each (N, 1, h, w), NEAREST..1, and where there are any.

    Where ``support`` (0..1) is 0 ``nearest`` and ``farthest`` say nothing, where ``mean_support``
    (0..1) is 0 ``mean`` does not.
    """

    nearest: Tensor
    farthest: Tensor
    mean: Tensor
    support: Tensor
    mean_support: Tensor


def carry_surfaces(measured: Tensor, *, levels: int) -> tuple[Surfaces, Tensor]:
    """Carry what was measured on to a dense grid of cells of COARSE_CELL pixels.

    measured (N, 2, H, W): the normalised depth, 0 where not measured, and the mask of measured
    pixels, 0 or 1; height and width are multiples of ``COARSE_CELL * 2**levels``. The nearest
    surface is the maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of
    depth; the mean is a pull-push pyramid of inverse depth, which reaches everywhere. Returns the
    surfaces, and the share of measured pixels in a cell, (N, 1, h, w).
    """
    depth, mask, inverse = measured[:, :1], measured[:, 1:], _inverse(measured)
    carried = cell_maxima(torch.cat([inverse, depth], dim=1), COARSE_CELL)
    for window in WINDOWS:
        carried = torch.where(carried > 0, carried, maxima_around(carried, window))
    support = (carried[:, 1:] > 0).to(depth.dtype)
    smooth = means_around(torch.cat([carried[:, :1], support], dim=1), 3)
    nearest = smooth[:, 1:].clamp(min=1e-6) / smooth[:, :1].clamp(min=1e-6)

    mean, density = pull_push(torch.cat([inverse, mask], dim=1), factor=COARSE_CELL, levels=levels)
    surfaces = Surfaces(
        nearest.clamp(NEAREST, 1.0),
        carried[:, 1:].clamp(NEAREST, 1.0),
        (mean[:, 1:].clamp(min=1e-6) / mean[:, :1].clamp(min=1e-6)).clamp(NEAREST, 1.0),
        support,
        mean[:, 1:],
    )
    return surfaces, density


def surface_features(surfaces: Surfaces, density: Tensor) -> Tensor:
    """What a convolution reads: (N, FEATURE_CHANNELS, h, w), each 0..1 and 0 without support."""
    depths = torch.cat([surfaces.nearest, surfaces.farthest, surfaces.mean], dim=1)
    known = torch.cat([surfaces.support, surfaces.support, surfaces.mean_support], dim=1)
    steps = (1.0 - torch.log(depths) * (1.0 / _LOG_NEAREST)) * known
    return torch.cat([steps, surfaces.support, surfaces.mean_support, density], dim=1)


def refine_surfaces(raised: Surfaces, measured: Tensor) -> Surfaces:
    """Put what was measured in a cell of FINE_CELL pixels in the place of what was carried there.

    A return takes the place of the surface that it lies on and leaves the other as it was: a LiDAR
    beside the camera sees past near edges, and what returns from behind one would tear it.
    raised: the coarse surfaces on the fine grid. measured: as in `carry_surfaces`.
    """
    depth, mask = measured[:, :1], measured[:, 1:]
    # The nearest by the least depth: what is not measured lies beyond everything.
    fine = cell_maxima(torch.cat([mask - depth, depth], dim=1), FINE_CELL)
    seen = fine[:, 1:] > 0
    nearest = (1.0 - fine[:, :1]).clamp(min=NEAREST)
    farthest = fine[:, 1:].clamp(min=NEAREST)
    between = torch.sqrt(raised.nearest * raised.farthest)
    on_near = nearest < torch.maximum(between, SAME_SURFACE * raised.nearest)
    on_far = farthest > torch.minimum(between, raised.farthest * (1.0 / SAME_SURFACE))
    return raised._replace(
        nearest=torch.where(seen & on_near, nearest, raised.nearest),
        farthest=torch.where(seen & on_far, farthest, raised.farthest),
    )


def choose_surface(head: Tensor, regressed: Tensor, surfaces: Surfaces) -> Tensor:
    """Normalised depth (N, 1, h, w), NEAREST..1, from the candidates and the network's own.

    head (N, HEAD_CHANNELS, h, w): logits of the trust in the mean, the farthest and the nearest
    surface, and a relative correction; the rest is for others. Each in turn replaces what was
    chosen before as far as it is trusted: nested sigmoids can give whatever weights a soft-max can.
    Without support the network's own depth is the answer.
    """
    trust = torch.sigmoid(head[:, :3])
    depth = regressed + trust[:, :1] * surfaces.mean_support * (surfaces.mean - regressed)
    depth = depth + trust[:, 1:2] * surfaces.support * (surfaces.farthest - depth)
    depth = depth + trust[:, 2:3] * surfaces.support * (surfaces.nearest - depth)
    return (depth * torch.exp(0.5 * torch.tanh(head[:, 3:4]))).clamp(NEAREST, 1.0)


def error_scale(head: Tensor, depth: Tensor) -> Tensor:
    """Scale of the error's Laplace distribution (N, 1, h, w), normalised as the depth is.

    head as in `choose_surface`: its fifth channel is the logit of the log of the scale's ratio to
    the depth between the bounds of LOG_SCALE.
    """
    least, greatest = LOG_SCALE
    return depth * torch.exp(least + (greatest - least) * torch.sigmoid(head[:, 4:5]))


def return_trust(head: Tensor) -> Tensor:
    """What the head says of the returns beside a pixel, (N, 3, h, w), 0..1: its last channels.

    The trust in a return before the predicted depth and in one behind it, see `take_returns`, and
    how much surer it makes, see `sharpen_scale`.
    """
    return torch.sigmoid(head[:, 5:8])


def spread_returns(measured: Tensor) -> Returns:
    """Spread what was measured over the pixels around it; measured: as in `carry_surfaces`."""
    inverse = _inverse(measured)
    for _ in range(RETURN_REACH):
        inverse = torch.where(inverse > 0, inverse, maxima_around(inverse, 3))
    near = (inverse > 0).to(inverse.dtype)
    return Returns(1.0 / inverse.clamp(min=1.0), near, measured[:, 1:])


def take_returns(depth: Tensor, returns: Returns, before: Tensor, behind: Tensor) -> Tensor:
    """Put the nearest return in the place of a pixel's predicted depth as far as it is trusted.

    What a coarser grid chose is a ramp at an edge; a return has its pixels on one side of it. A
    LiDAR beside the camera sees past near edges, so what lies behind the predicted depth is another
    matter than what lies before it. A return at the pixel itself that agrees is taken as it is.

    All (N, 1, H, W), depth normalised; before, behind: 0..1, the trust in a return before the
    predicted depth, and in one behind it.
    """
    step = (returns.depth - depth) * returns.near
    taken = before * step.clamp(max=0.0) + behind * step.clamp(min=0.0)
    agrees = (2.0 - step.abs() / depth * (1.0 / AGREEMENT)).clamp(0.0, 1.0) * returns.here
    return depth + taken + agrees * (step - taken)


def sharpen_scale(scale: Tensor, returns: Returns, surer: Tensor) -> Tensor:
    """Lessen the error's scale near returns, all (N, 1, H, W); surer: 0..1, 1 = by MOST_SURER."""
    return scale * (1.0 - MOST_SURER * surer * returns.near)


def _inverse(measured: Tensor) -> Tensor:
    """Inverse of the normalised depth, 1..1/NEAREST, 0 where not measured."""
    return measured[:, 1:] / measured[:, :1].clamp(min=NEAREST)
