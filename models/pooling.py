"""Pooling in cells and in windows, (N, C, H, W) -> (N, C, h, w)."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from models import fast_cpu
from models.fast_cpu import fast_on_cpu

# Kernel (24, 1, 5, 5) that selects each pixel around the centre.
_SHIFTS = np.delete(np.eye(25, dtype=np.float32), 12, axis=0).reshape(24, 1, 5, 5)


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

    Each shift is a channel, which makes two operations in an exported graph.
    """
    shifts = torch.from_numpy(_SHIFTS).to(x)
    return F.conv2d(x, shifts, padding=2).amax(dim=1, keepdim=True)
