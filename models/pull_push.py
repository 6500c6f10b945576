"""Pull-push pyramid: dense values from sparse ones (Gortler et al. 1996)."""

from torch import Tensor

from models.blocks import upsample
from models.pooling import cell_means

#: Weight of the coarser level against one fully measured cell. A single return in a 4x4 cell
#: weighs 1/16, so a measured cell keeps 98 % of its measurement.
COARSE_WEIGHT = 1e-3


def pull_push(measured: Tensor, *, factor: int, levels: int) -> tuple[Tensor, Tensor]:
    """Fill a sparse value on a grid ``factor`` times coarser.

    Masked means are pulled up a pyramid of ``levels`` halvings and pushed down again into the
    cells without a measurement. measured (N, 2, H, W): the value, 0 where not measured, and the
    mask of measured pixels, 0 or 1; height and width are multiples of ``factor * 2**levels``.
    Returns the weighted value and its support 0..1, (N, 2, h, w), whose ratio is a weighted mean of
    the measurements and which are 0 beyond the reach of the coarsest level, and the share of
    measured pixels, (N, 1, h, w).
    """
    # Value and mask as one tensor: a level costs one pooling and one upsampling.
    pyramid = [cell_means(measured, factor)]
    for _ in range(levels):
        pyramid.append(cell_means(pyramid[-1], 2))
    coarse = pyramid[-1] / (pyramid[-1][:, 1:] + COARSE_WEIGHT)
    for level in reversed(pyramid[:-1]):
        coarse = (level + COARSE_WEIGHT * upsample(coarse)) / (level[:, 1:] + COARSE_WEIGHT)
    return coarse, pyramid[0][:, 1:]
