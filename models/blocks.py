"""Building blocks of the networks."""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

#: Up to this number of channels maps are upsampled one by one, see `_UpsampleFew`.
_FEW_CHANNELS = 8


class ConvBNReLU(nn.Sequential):
    """3x3 (or 1x1) convolution, batch normalisation, ReLU: (N, C, H, W) -> (N, C', H', W')."""

    def __init__(
        self, in_channels: int, out_channels: int, *, kernel: int = 3, stride: int = 1
    ) -> None:
        super().__init__(
            nn.Conv2d(in_channels, out_channels, kernel, stride, kernel // 2, bias=False),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(inplace=True),
        )


class BaConv(nn.Module):
    """Boundary-aware convolution, Eq. 1: y(p) = sum_n w(p_n) x(p_n) (1 - B(p_n)).

    Gating the input before an ordinary convolution gives the same sum, so an exported graph needs
    no custom operator, only `Mul` and `Conv`.

    Shapes: x (N, C, H, W), boundary (N, 1, H, W) in 0..1, None = 0; returns (N, C', H, W). No
    bias.
    """

    def __init__(self, in_channels: int, out_channels: int, *, kernel: int = 3) -> None:
        super().__init__()
        self.conv = nn.Conv2d(in_channels, out_channels, kernel, padding=kernel // 2, bias=False)

    def forward(self, x: Tensor, boundary: Tensor | None) -> Tensor:
        """Convolve x * (1 - boundary)."""
        if boundary is not None:
            inside = 1.0 - boundary
            channels_last = x.is_contiguous(memory_format=torch.channels_last)
            if channels_last and not torch.compiler.is_exporting():
                # Expand over the channels first: a product with a map of one channel is scalar
                # code in bfloat16, which takes four times as long.
                inside = inside.expand_as(x).contiguous(memory_format=torch.channels_last)
            x = x * inside
        out: Tensor = self.conv(x)
        return out


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions around an identity (He et al. 2016), for the lite encoder."""

    def __init__(self, in_channels: int, out_channels: int, *, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = ConvBNReLU(in_channels, out_channels, stride=stride)
        self.conv2 = nn.Sequential(
            nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(out_channels),
        )
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or in_channels != out_channels:
            self.shortcut = nn.Sequential(
                nn.Conv2d(in_channels, out_channels, 1, stride, bias=False),
                nn.BatchNorm2d(out_channels),
            )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', ceil(H / stride), ceil(W / stride))."""
        return F.relu(self.conv2(self.conv1(x)) + self.shortcut(x))


class GlobalContext(nn.Module):
    """Adds the projected global mean of the features to them: (N, C, H, W) -> same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # No batch normalisation: one value a channel and image is too few to normalise over.
        self.project = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return relu(x + W mean(x))."""
        return F.relu(x + self.project(x.mean(dim=(2, 3), keepdim=True)))


def upsample(x: Tensor, *, factor: int = 2, size: tuple[int, int] | None = None) -> Tensor:
    """Bilinear upsampling with half-pixel centres, by an integer factor or to (height, width)."""
    if size is not None:
        return F.interpolate(x, size=size, mode="bilinear", align_corners=False)
    if factor == 1:
        return x
    if x.shape[1] <= _FEW_CHANNELS and x.requires_grad:
        upsampled: Tensor = _UpsampleFew.apply(x, factor)
        return upsampled
    return F.interpolate(x, scale_factor=float(factor), mode="bilinear", align_corners=False)


class _UpsampleFew(torch.autograd.Function):
    """Bilinear upsampling of few channels, whose gradient is sums of shifted maps.

    On a CPU PyTorch's own gradient takes three to nine times as long for so few channels; from
    sixteen channels on it is faster. The forward pass treats each map as a picture of its own,
    which PyTorch does faster too.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, factor: int) -> Tensor:
        ctx.factor = factor
        maps = x.float().flatten(0, 1).unsqueeze(1)
        upsampled = F.interpolate(
            maps, scale_factor=float(factor), mode="bilinear", align_corners=False
        )
        return upsampled.reshape(*x.shape[:2], *upsampled.shape[2:]).to(x.dtype)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        gradient = gradients[0].float().contiguous()
        for dim in (2, 3):
            gradient = _sum_under_tents(gradient, dim, ctx.factor)
        return gradient.to(gradients[0].dtype), None


def _sum_under_tents(gradient: Tensor, dim: int, factor: int) -> Tensor:
    """Adjoint of linear upsampling along one dimension."""
    cells = gradient.unflatten(dim, (-1, factor))
    count = cells.shape[dim]
    total = torch.zeros_like(cells.select(dim + 1, 0))
    for place in range(factor):
        part = cells.select(dim + 1, place)
        offset = (place + 0.5) / factor - 0.5  # from the middle of its cell
        total.add_(part, alpha=1.0 - abs(offset))
        # The rest belongs to the neighbour; at the edge, where there is none, to the cell itself.
        here, there = (0, 1) if offset > 0 else (1, 0)
        edge = count - 1 if offset > 0 else 0
        total.narrow(dim, there, count - 1).add_(
            part.narrow(dim, here, count - 1), alpha=abs(offset)
        )
        total.narrow(dim, edge, 1).add_(part.narrow(dim, edge, 1), alpha=abs(offset))
    return total


def pad_to_multiple(x: Tensor, multiple: int) -> Tensor:
    """Pad (N, C, H, W) with zeros at the bottom and right to a multiple of ``multiple``."""
    height, width = x.shape[2], x.shape[3]
    padding = (0, -width % multiple, 0, -height % multiple)
    if not torch.compiler.is_exporting() and not any(padding):
        return x  # padding by 0 would copy
    return F.pad(x, padding)


def extend_to_multiple(x: Tensor, multiple: int) -> Tensor:
    """Repeat the last row and column of (N, C, H, W) up to a multiple of ``multiple``.

    For maps that are pooled next: ONNX Runtime fuses zero padding into a pooling, and then refuses
    a model whose padding is as wide as the window.
    """
    height, width = x.shape[2], x.shape[3]
    padding = (0, -width % multiple, 0, -height % multiple)
    if not torch.compiler.is_exporting() and not any(padding):
        return x
    return F.pad(x, padding, mode="replicate")


def adaptive_mean(x: Tensor, cells: int) -> Tensor:
    """Mean over a grid of cells x cells: (N, C, H, W) -> (N, C, cells, cells).

    Adaptive average pooling as two products, which ONNX can express for any H and W.
    """
    rows, columns = (_cell_means(x, x.shape[axis], cells) for axis in (2, 3))
    return rows @ x @ columns.transpose(0, 1)


def _cell_means(x: Tensor, length: int, cells: int) -> Tensor:
    """Weights (cells, length) of the means.

    Cell i goes from floor(i * length / cells) to ceil((i + 1) * length / cells).
    """
    place = torch.arange(length, device=x.device)
    cell = torch.arange(cells, device=x.device)[:, None]
    inside = (place >= cell * length // cells) & (place < -(-(cell + 1) * length // cells))
    weights = inside.to(x.dtype)
    return weights / weights.sum(dim=1, keepdim=True)
