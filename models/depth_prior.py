"""A dense first guess of the depth from the sparse measurements alone."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.blocks import upsample

#: Weight of the coarser level against one fully measured cell. A single return in a 4x4 cell
#: weighs 1/16, so a measured cell keeps 98 % of its measurement.
COARSE_WEIGHT = 1e-3


class DepthPrior(NamedTuple):
    """Filled depth, share of measured pixels and share of support, each (N, 1, h, w) in 0..1."""

    filled: Tensor
    density: Tensor
    support: Tensor


def pull_push_fill(depth: Tensor, valid_mask: Tensor, *, factor: int, levels: int) -> DepthPrior:
    """Fill sparse depth on a grid ``factor`` times coarser by the pull-push method.

    Masked means are pulled up a pyramid of ``levels`` halvings and pushed down again into the
    cells without a measurement (Gortler et al. 1996). Cells that no level reaches, and the
    whole map when nothing is measured, come out as filled 0 with support 0.

    depth (N, 1, H, W), normalised, 0 where ``valid_mask`` (same shape, 0 or 1) is 0; height and
    width are multiples of ``factor * 2**levels``.
    """
    weighted = F.avg_pool2d(depth, factor)
    density = F.avg_pool2d(valid_mask, factor)
    pyramid = [(weighted, density)]
    for _ in range(levels):
        weighted, density = F.avg_pool2d(weighted, 2), F.avg_pool2d(density, 2)
        pyramid.append((weighted, density))

    # One tensor for both, so that a level costs one Resize: [filled, support].
    coarse = torch.cat(pyramid[-1], dim=1) / (pyramid[-1][1] + COARSE_WEIGHT)
    for weighted, density in reversed(pyramid[:-1]):
        measured = torch.cat((weighted, density), dim=1)
        coarse = (measured + COARSE_WEIGHT * upsample(coarse)) / (density + COARSE_WEIGHT)
    weighted, support = coarse[:, :1], coarse[:, 1:]
    # Both went through the same sums, so their ratio is a weighted mean of measurements.
    return DepthPrior(weighted / support.clamp(min=1e-6), pyramid[0][1], support)
