"""A dense first guess of the depth from the sparse measurements alone."""

from typing import NamedTuple

from torch import Tensor

from models.blocks import upsample
from models.pooling import cell_means

#: Weight of the coarser level against one fully measured cell. A single return in a 4x4 cell
#: weighs 1/16, so a measured cell keeps 98 % of its measurement.
COARSE_WEIGHT = 1e-3


class DepthPrior(NamedTuple):
    """Filled depth, share of measured pixels and share of support, each (N, 1, h, w) in 0..1."""

    filled: Tensor
    density: Tensor
    support: Tensor


def pull_push_fill(measured: Tensor, *, factor: int, levels: int) -> DepthPrior:
    """Fill sparse depth on a grid ``factor`` times coarser by the pull-push method.

    Masked means are pulled up a pyramid of ``levels`` halvings and pushed down again into the
    cells without a measurement (Gortler et al. 1996). Cells that no level reaches, and the
    whole map when nothing is measured, come out as filled 0 with support 0.

    measured (N, 2, H, W): the normalised depth, 0 where not measured, and the mask of measured
    pixels, 0 or 1; height and width are multiples of ``factor * 2**levels``.
    """
    filled, density = pull_push(measured, factor=factor, levels=levels)
    weighted, support = filled[:, :1], filled[:, 1:]
    return DepthPrior(weighted / support.clamp(min=1e-6), density, support)


def pull_push(measured: Tensor, *, factor: int, levels: int) -> tuple[Tensor, Tensor]:
    """Carry a value, 0 where not measured, and its mask through the pyramid of `pull_push_fill`.

    measured (N, 2, H, W) as there. Returns the weighted value and its support, (N, 2, h, w), whose
    ratio is a weighted mean of measurements, and the share of measured pixels, (N, 1, h, w).
    """
    # Both go through the same steps as one tensor: a level costs one pooling and one upsampling.
    pyramid = [cell_means(measured, factor)]
    for _ in range(levels):
        pyramid.append(cell_means(pyramid[-1], 2))
    coarse = pyramid[-1] / (pyramid[-1][:, 1:] + COARSE_WEIGHT)
    for level in reversed(pyramid[:-1]):
        coarse = (level + COARSE_WEIGHT * upsample(coarse)) / (level[:, 1:] + COARSE_WEIGHT)
    return coarse, pyramid[0][:, 1:]
