"""Pull-push pyramid: dense values from sparse ones (Gortler et al. 1996)."""

from torch import Tensor

from models.blocks import upsample
from models.pooling import cell_means, halve

#: Weight of the coarser level against one fully measured cell. A single return in a 4x4 cell
#: weighs 1/16, so a measured cell keeps 98 % of its measurement.
COARSE_WEIGHT = 1e-3
#: Share of measured pixels far below that of one return in the largest map.
NOTHING = 1e-10


def pull_push(measured: Tensor, *, factor: int, levels: int) -> tuple[Tensor, Tensor]:
    """Fill a sparse value on a grid ``factor`` times coarser.

    Masked means are pulled up a pyramid of ``levels`` halvings and then to one mean of the map, and
    pushed down again into the cells without a measurement. The windows of a halving overlap, so
    that the result changes little with the position of the grid. measured (N, 2, H, W): the value,
    0 where not measured, and the mask of measured pixels, 0 or 1; height and width are multiples of
    ``factor * 2**levels``. Returns the weighted value and its support 0..1, (N, 2, h, w), whose
    ratio is a weighted mean of the measurements and which are 0 where nothing is measured in the
    whole map, and the share of measured pixels, (N, 1, h, w).
    """
    # Value and mask as one tensor: a level costs one pooling and one upsampling.
    pyramid = [cell_means(measured, factor)]
    for _ in range(levels):
        pyramid.append(halve(pyramid[-1]))
    whole = pyramid[0].mean(dim=(2, 3), keepdim=True)
    filled = whole / (whole[:, 1:] + NOTHING)
    for level in reversed(pyramid):
        filled = (level + COARSE_WEIGHT * filled) / (level[:, 1:] + COARSE_WEIGHT)
        if level is not pyramid[0]:
            filled = upsample(filled)
    return filled, pyramid[0][:, 1:]
