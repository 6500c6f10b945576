"""Max-unpooling over 2x2 windows, in operators that every ONNX runtime has."""

from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional as F

# Values within this share of each other count as equal: implementations of a convolution round
# differently, and the position of the maximum must not depend on that.
_ROUNDING = 1e-5


def windows(x: Tensor) -> Tensor:
    """2x2 windows, row by row: (N, C, H, W) -> (N, C, 4, H / 2, W / 2). H and W are even."""
    batch, channels, height, width = x.shape
    return F.pixel_unshuffle(x, 2).view(batch, channels, 4, height // 2, width // 2)


def max_mask(x: Tensor) -> Tensor:
    """Return True at the first of the largest values of each window, once per window.

    (N, C, H, W) -> bool (N, C, 4, H / 2, W / 2), in the order of `windows`.
    """
    values = windows(x)
    largest = reduce(torch.maximum, values.unbind(2))
    large = (values >= (largest - _ROUNDING * largest.abs()).unsqueeze(2)).unbind(2)
    first, found = [large[0]], large[0]
    for each in large[1:]:
        first.append(each & ~found)
        found = found | each
    return torch.stack(first, dim=2)


def max_unpool(x: Tensor, mask: Tensor) -> Tensor:
    """Max-unpooling: each value goes back to its position in its window, the rest is 0.

    x (N, C, h, w) and the mask from `max_mask` give (N, C, 2 h, 2 w).
    """
    return F.pixel_shuffle(torch.where(mask, x.unsqueeze(2), 0.0).flatten(1, 2), 2)
