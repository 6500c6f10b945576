"""Pooling in cells and in windows, (N, C, H, W) -> (N, C, h, w)."""

import torch
from torch import Tensor
from torch.nn import functional as F

from models import fast_cpu
from models.fast_cpu import fast_on_cpu


@fast_on_cpu(fast_cpu.cell_means)
def cell_means(x: Tensor, side: int) -> Tensor:
    """Mean over each square cell; its side is a power of two."""
    return F.avg_pool2d(x, side)


@fast_on_cpu(fast_cpu.cell_maxima)
def cell_maxima(x: Tensor, side: int) -> Tensor:
    """Maximum over each square cell; its side is a power of two."""
    return F.max_pool2d(x, side)


@fast_on_cpu(fast_cpu.window_means)
def window_means(x: Tensor, window: int) -> Tensor:
    """Mean over the square window around each pixel, 0 beyond the map."""
    return F.avg_pool2d(x, window, 1, window // 2)


@fast_on_cpu(fast_cpu.window_maxima)
def window_maxima(x: Tensor, window: int) -> Tensor:
    """Maximum over the square window around each pixel.

    It is taken over columns first and then over rows, which is faster from 5 pixels on.
    """
    half = window // 2
    if window == 3:
        return F.max_pool2d(x, window, 1, half)
    columns = F.max_pool2d(x, (window, 1), 1, (half, 0))
    return F.max_pool2d(columns, (1, window), 1, (0, half))


def neighbour_maxima(x: Tensor) -> Tensor:
    """Maximum over the 24 pixels around each pixel, 0 beyond the map: (N, 1, H, W) -> same.

    It is that of the rows above and below, each over 5 pixels, and of the pixels to both sides.
    """
    rows = F.max_pool2d(x, (1, 5), 1, (0, 2))
    rows = F.pad(F.max_pool2d(rows, (2, 1), 1, (1, 0)), (0, 0, 1, 1))
    columns = F.pad(F.max_pool2d(x, (1, 2), 1, (0, 1)), (1, 1))
    outside = torch.maximum(rows[:, :, :-3], rows[:, :, 3:])
    return torch.maximum(outside, torch.maximum(columns[..., :-3], columns[..., 3:]))
