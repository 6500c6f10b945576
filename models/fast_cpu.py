"""Faster forms of operations that PyTorch computes slowly on a CPU for few channels.

Networks call the plain form in `models.pooling` or `models.blocks`, which is marked with
`fast_on_cpu`. On a CPU the fast form of this module is called instead, but not in an exported
graph: ONNX Runtime is fast with the plain form.
"""

import functools
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec

import torch
from torch import Tensor
from torch.nn import functional as F

P = ParamSpec("P")
Operation = Callable[Concatenate[Tensor, P], Tensor]

# Up to this number of channels the maps are upsampled one by one; from 16 channels on PyTorch is
# faster.
_FEW_CHANNELS = 8


def fast_on_cpu(fast: Operation[P]) -> Callable[[Operation[P]], Operation[P]]:
    """Replace an operation by a faster form of equal result; `__wrapped__` is the plain form."""

    def decorate(plain: Operation[P]) -> Operation[P]:
        @functools.wraps(plain)
        def call(x: Tensor, /, *args: P.args, **kwargs: P.kwargs) -> Tensor:
            is_fast = x.device.type == "cpu" and not torch.compiler.is_exporting()
            return (fast if is_fast else plain)(x, *args, **kwargs)

        return call

    return decorate


def cell_means(x: Tensor, side: int) -> Tensor:
    """Sums of shifted maps: PyTorch's own pooling takes 10 to 100 times as long."""
    return _join_cells(x, side, torch.add) / side**2


def cell_maxima(x: Tensor, side: int) -> Tensor:
    """Maxima of shifted maps, see `cell_means`."""
    return _join_cells(x, side, torch.maximum)


def _join_cells(x: Tensor, side: int, join: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    for _ in range(side.bit_length() - 1):
        x = join(x[:, :, ::2], x[:, :, 1::2])  # rows first: contiguous in memory
        x = join(x[..., ::2], x[..., 1::2])
    return x


def window_means(x: Tensor, window: int) -> Tensor:
    """Sums of shifted maps, see `cell_means`."""
    half = window // 2
    x = F.pad(x, (half, half, half, half))
    for dim in (2, 3):
        length = x.shape[dim] - 2 * half
        total = x.narrow(dim, 0, length) + x.narrow(dim, 1, length)
        for offset in range(2, window):
            total += x.narrow(dim, offset, length)
        x = total
    return x / window**2


def window_maxima(x: Tensor, window: int) -> Tensor:
    """Maxima of shifted maps, see `cell_means`; each step doubles the window."""
    half = window // 2
    x = F.pad(x, (half, half, half, half), value=float("-inf"))
    for dim in (2, 3):
        span = 1  # width of the window whose maximum x holds
        while span < window:
            step = min(span, window - span)
            length = x.shape[dim] - step
            x = torch.maximum(x.narrow(dim, 0, length), x.narrow(dim, step, length))
            span += step
    return x


def gate(x: Tensor, boundary: Tensor) -> Tensor:
    """Expand the gate over the channels before the product.

    In channels-last order a product with a map of one channel is scalar code in bfloat16, which
    takes four times as long.
    """
    inside = 1.0 - boundary
    if x.is_contiguous(memory_format=torch.channels_last):
        inside = inside.expand_as(x).contiguous(memory_format=torch.channels_last)
    return x * inside


def enlarge(x: Tensor, factor: int) -> Tensor:
    """Upsample few maps one by one; the gradient takes a third to a ninth of PyTorch's time."""
    if x.shape[1] <= _FEW_CHANNELS and x.requires_grad:
        enlarged: Tensor = _EnlargeFew.apply(x, factor)
        return enlarged
    return F.interpolate(x, scale_factor=float(factor), mode="bilinear", align_corners=False)


class _EnlargeFew(torch.autograd.Function):
    """Bilinear upsampling of few channels, whose gradient is sums of shifted maps."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, factor: int) -> Tensor:
        ctx.factor = factor
        maps = x.float().flatten(0, 1).unsqueeze(1)
        enlarged = F.interpolate(
            maps, scale_factor=float(factor), mode="bilinear", align_corners=False
        )
        return enlarged.reshape(*x.shape[:2], *enlarged.shape[2:]).to(x.dtype)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        gradient = gradients[0].float().contiguous()
        for dim in (2, 3):
            gradient = _upsampling_gradient(gradient, dim, ctx.factor)
        return gradient.to(gradients[0].dtype), None


def _upsampling_gradient(gradient: Tensor, dim: int, factor: int) -> Tensor:
    """Adjoint of linear upsampling along one dimension."""
    cells = gradient.unflatten(dim, (-1, factor))
    count = cells.shape[dim]
    total = torch.zeros_like(cells.select(dim + 1, 0))
    for place in range(factor):
        part = cells.select(dim + 1, place)
        offset = (place + 0.5) / factor - 0.5  # measured from the middle of the cell
        total.add_(part, alpha=1.0 - abs(offset))
        # The rest belongs to the neighbour, or at the edge, which has none, to the cell itself.
        here, there = (0, 1) if offset > 0 else (1, 0)
        edge = count - 1 if offset > 0 else 0
        total.narrow(dim, there, count - 1).add_(
            part.narrow(dim, here, count - 1), alpha=abs(offset)
        )
        total.narrow(dim, edge, 1).add_(part.narrow(dim, edge, 1), alpha=abs(offset))
    return total
