"""Means over known pixels, and maps on other grids."""

import torch.nn.functional as F
from torch import Tensor

from models.blocks import extend_to_multiple
from models.pooling import cell_means
from training.base.processes import sum_over_processes


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean over the masked pixels of each sample, then over the samples that have any: ().

    `values` float (N, 1, H, W), finite everywhere; `mask` bool of the same shape. A sample with
    dense ground truth and one with a few thousand LiDAR returns have the same weight. 0, with a
    gradient of 0, if the mask is empty. Samples of all processes count.
    """
    known = mask.to(values.dtype)
    counts = known.sum(dim=(1, 2, 3))
    means = (values * known).sum(dim=(1, 2, 3)) / counts.clamp(min=1)
    samples = sum_over_processes((counts > 0).sum())
    return sum_over_processes(means.sum()) / samples.clamp(min=1)


def grid_of(x: Tensor) -> tuple[int, int]:
    """Return (height, width) of maps (..., h, w)."""
    return x.shape[-2], x.shape[-1]


def split_into_blocks(x: Tensor, grid: tuple[int, int], fill: float = 0) -> tuple[Tensor, int]:
    """Pad a full-size map so that it divides into a coarser grid; return it and the block's side.

    `x` float (N, C, H, W); `grid` (height, width) of a map whose cells are squares of 2^k pixels
    from the top left on. The last cells may extend beyond the image, after ceil-mode pooling or
    padding to the stride; the padding is `fill`.
    """
    side = cell_side(grid_of(x), grid)
    padding = (0, side * grid[1] - x.shape[-1], 0, side * grid[0] - x.shape[-2])
    return F.pad(x, padding, value=fill), side


def cell_side(size: tuple[int, int], grid: tuple[int, int]) -> int:
    """Return the side of a cell of `grid` in pixels, see `split_into_blocks`."""
    side = 1
    while side * grid[0] < size[0] or side * grid[1] < size[1]:
        side *= 2
    return side


def on_grid(x: Tensor, grid: tuple[int, int]) -> Tensor:
    """Resize (N, C, H, W) to a coarser grid by means, or to a finer one bilinearly."""
    if x.shape[-2] < grid[0]:
        return F.interpolate(x, size=grid, mode="bilinear", align_corners=False)
    side = cell_side(grid_of(x), grid)
    return x if side == 1 else cell_means(extend_to_multiple(x, side), side)
