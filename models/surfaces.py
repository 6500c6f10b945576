"""Dense depth from sparse depth by choosing among surfaces that were measured.

A mean of 5 m and 80 m is a surface that is nowhere. What was measured around a pixel is kept apart
instead, as the nearest surface, the farthest and the mean of inverse depth, and the network says
which of them a pixel shows.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from models.depth_prior import pull_push
from models.pooling import cell_maxima, maxima_around, means_around

#: Windows of the max-pools that carry a surface on into cells without any, one after the other:
#: together they reach 18 cells.
WINDOWS = (3, 3, 5, 7, 9, 15)
#: Normalised depth below which no surface lies.
NEAREST = 1e-3
#: A return within this share of the predicted depth is taken as it is, one beyond twice as much is
#: not: it may show through the gap between two surfaces.
AGREEMENT = 0.05


class Surfaces(NamedTuple):
    """Candidates of the normalised depth, each (N, 1, h, w), and where there are any.

    Where ``support`` (0 or 1) is 0 ``nearest`` and ``farthest`` say nothing, where
    ``mean_support`` (0..1) is 0 ``mean`` does not.
    """

    nearest: Tensor
    farthest: Tensor
    mean: Tensor
    support: Tensor
    mean_support: Tensor
    #: Share of measured pixels in a cell.
    density: Tensor

    def features(self) -> Tensor:
        """What a convolution can read of them: (N, 6, h, w), each 0..1 and 0 without support."""
        steps = [
            (1.0 - torch.log(depth) / _LOG_NEAREST) * known
            for depth, known in (
                (self.nearest, self.support),
                (self.farthest, self.support),
                (self.mean, self.mean_support),
            )
        ]
        return torch.cat([*steps, self.support, self.mean_support, self.density], dim=1)


_LOG_NEAREST = -6.907755  # log(NEAREST)


def gather_surfaces(measured: Tensor, *, factor: int, levels: int) -> Surfaces:
    """Carry what was measured on to a dense grid, ``factor`` times coarser than the input.

    measured (N, 2, H, W): the normalised depth, 0 where not measured, and the mask of measured
    pixels, 0 or 1; height and width are multiples of ``factor * 2**levels``. The nearest surface is
    the maximum of inverse depth, smoothed over 3 x 3 cells, the farthest the maximum of depth; the
    mean is a pull-push pyramid (Gortler et al. 1996) of inverse depth, which reaches everywhere.
    """
    depth, mask = measured[:, :1], measured[:, 1:]
    inverse = mask / depth.clamp(min=NEAREST)
    carried = cell_maxima(torch.cat([inverse, depth], dim=1), factor)
    for window in WINDOWS:
        carried = torch.where(carried > 0, carried, maxima_around(carried, window))
    support = (carried[:, 1:] > 0).to(depth.dtype)
    smooth = means_around(torch.cat([carried[:, :1], support], dim=1), 3)
    nearest = smooth[:, 1:].clamp(min=1e-6) / smooth[:, :1].clamp(min=1e-6)

    coarse, density = pull_push(torch.cat([inverse, mask], dim=1), factor=factor, levels=levels)
    mean = coarse[:, 1:].clamp(min=1e-6) / coarse[:, :1].clamp(min=1e-6)
    return Surfaces(
        nearest.clamp(NEAREST, 1.0),
        carried[:, 1:].clamp(NEAREST, 1.0),
        mean.clamp(NEAREST, 1.0),
        support,
        coarse[:, 1:],
        density,
    )


def choose_surface(head: Tensor, regressed: Tensor, surfaces: Surfaces) -> Tensor:
    """Normalised depth (N, 1, h, w), NEAREST..1, from the candidates and the network's own.

    head (N, 4, h, w): logits of the trust in the mean, the farthest and the nearest surface, and a
    relative correction. Each in turn replaces what was chosen before as far as it is trusted:
    nested sigmoids can give whatever weights a soft-max can. Without support the network's own
    depth is the answer.
    """
    trust = torch.sigmoid(head[:, :3])
    depth = regressed + trust[:, :1] * surfaces.mean_support * (surfaces.mean - regressed)
    depth = depth + trust[:, 1:2] * surfaces.support * (surfaces.farthest - depth)
    depth = depth + trust[:, 2:3] * surfaces.support * (surfaces.nearest - depth)
    return (depth * torch.exp(0.5 * torch.tanh(head[:, 3:]))).clamp(NEAREST, 1.0)


def keep_measurements(depth: Tensor, measured: Tensor) -> Tensor:
    """Take the returns that agree with a predicted depth: (N, 1, H, W), normalised.

    measured (N, 2, H, W) as in `gather_surfaces`, at the size of ``depth``.
    """
    returned, mask = measured[:, :1], measured[:, 1:]
    difference = (returned - depth).abs() / depth
    agrees = (2.0 - difference * (1.0 / AGREEMENT)).clamp(0.0, 1.0) * mask
    return depth + agrees * (returned - depth)
