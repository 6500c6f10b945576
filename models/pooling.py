"""Pooling of maps of one or two channels, as sums and maxima of shifted maps.

On a CPU PyTorch's own poolings take 10 to 100 times as long for so few channels. An exported graph
uses pooling operators, which are faster in ONNX Runtime.
"""

from collections.abc import Callable
from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional as F


def cell_means(x: Tensor, side: int) -> Tensor:
    """Mean over each square cell of the side, a power of two: (N, C, H, W) -> (N, C, h, w)."""
    if torch.compiler.is_exporting():
        return F.avg_pool2d(x, side)
    return _join_cells(x, side, torch.add) / side**2


def cell_maxima(x: Tensor, side: int) -> Tensor:
    """Maximum over each square cell of the side, a power of two: (N, C, H, W) -> (N, C, h, w)."""
    if torch.compiler.is_exporting():
        return F.max_pool2d(x, side)
    return _join_cells(x, side, torch.maximum)


def _join_cells(x: Tensor, side: int, join: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    for _ in range(side.bit_length() - 1):
        x = join(x[:, :, ::2], x[:, :, 1::2])  # rows first: contiguous in memory
        x = join(x[..., ::2], x[..., 1::2])
    return x


def means_around(x: Tensor, window: int) -> Tensor:
    """Mean over the square window around each pixel, 0 beyond the map: (N, C, H, W) -> same."""
    half = window // 2
    if torch.compiler.is_exporting():
        return F.avg_pool2d(x, window, 1, half)
    x = F.pad(x, (half, half, half, half))
    for dim in (2, 3):
        length = x.shape[dim] - 2 * half
        total = x.narrow(dim, 0, length) + x.narrow(dim, 1, length)
        for offset in range(2, window):
            total += x.narrow(dim, offset, length)
        x = total
    return x / window**2


def maxima_around(x: Tensor, window: int) -> Tensor:
    """Maximum over the square window around each pixel: (N, C, H, W) -> same.

    First over columns, then over rows: 30 steps for a window of 225 pixels.
    """
    half = window // 2
    if torch.compiler.is_exporting() and window == 3:
        return F.max_pool2d(x, window, 1, half)  # faster than two steps
    if torch.compiler.is_exporting():
        columns = F.max_pool2d(x, (window, 1), 1, (half, 0))
        return F.max_pool2d(columns, (1, window), 1, (0, half))
    x = F.pad(x, (half, half, half, half), value=float("-inf"))
    for dim in (2, 3):
        span = 1  # x holds the maximum over so many pixels
        while span < window:
            step = min(span, window - span)
            length = x.shape[dim] - step
            x = torch.maximum(x.narrow(dim, 0, length), x.narrow(dim, step, length))
            span += step
    return x


def maxima_beside(x: Tensor) -> Tensor:
    """Maximum over the 24 pixels around each, without itself, 0 beyond: (N, C, H, W) -> same.

    x: not negative.
    """
    height, width = x.shape[2], x.shape[3]
    x = F.pad(x, (2, 2, 2, 2))
    rows = reduce(torch.maximum, [x[..., place : place + width] for place in range(5)])
    others = [rows[:, :, place : place + height] for place in (0, 1, 3, 4)]
    row = x[:, :, 2 : 2 + height]
    others += [row[..., place : place + width] for place in (0, 1, 3, 4)]
    return reduce(torch.maximum, others)
