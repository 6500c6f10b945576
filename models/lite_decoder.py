"""The decoders of `SSDNetLite`: boundary-aware as the paper's, with skips that are added."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import BaConv, boundary_side, conv_bn, shortcut, upsample

# Channels of a side output of the boundary decoder.
_SIDE_CHANNELS = 16


class BoundaryDecoder(nn.Module):
    """A logit of a boundary from each skip, and all of them fused at the finest."""

    def __init__(self, skip_channels: Sequence[int], *, separable: bool) -> None:
        super().__init__()
        self.sides = nn.ModuleList(
            boundary_side(skip, _SIDE_CHANNELS, separable=separable) for skip in skip_channels
        )
        self.fuse = nn.Conv2d(len(skip_channels), 1, 1)

    def forward(self, skips: Sequence[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Return the fused logits (N, 1, h, w) and those of each skip, finest first."""
        sides = [side(skip) for side, skip in zip(self.sides, skips, strict=True)]
        same_size = [upsample(logit, factor=2**level) for level, logit in enumerate(sides)]
        return self.fuse(torch.cat(same_size, dim=1)), sides


class UpBlock(nn.Module):
    """up(x) + 1x1(skip), BaConv 3x3, BN, ReLU; the skip has twice the size of x.

    The encoder's features have no activation, and their magnitudes differ by stride: both are
    normalised before they are added.
    """

    def __init__(
        self, in_channels: int, skip_channels: int, channels: int, *, separable: bool
    ) -> None:
        super().__init__()
        self.reduce = shortcut(in_channels, channels, stride=1)
        self.project = conv_bn(skip_channels, channels, kernel=1)
        self.baconv = BaConv(channels, channels, separable=separable)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor, skip: Tensor, boundary: Tensor | None = None) -> Tensor:
        """Join x (N, C, h, w), skip (N, S, H, W) and boundary (N, 1, H, W) to (N, C', H, W)."""
        # Reduced before it is upsampled: a quarter of the work.
        x = upsample(self.reduce(x)) + self.project(skip)
        return F.relu(self.norm(self.baconv(x, boundary)))


class TaskDecoder(nn.Module):
    """UpBlocks from the bottom to the finest skip.

    Args:
        bottom_channels: channels of the bottom.
        skip_channels: channels of each skip, finest first.
        channels: channels of each block, coarsest first.
        separable: whether the BaConv of each block is separable, coarsest first; None = none is.
    """

    def __init__(
        self,
        bottom_channels: int,
        skip_channels: Sequence[int],
        channels: Sequence[int],
        separable: Sequence[bool] | None = None,
    ) -> None:
        super().__init__()
        below = (bottom_channels, *channels[:-1])
        separable = separable or [False] * len(channels)
        sides = zip(below, reversed(skip_channels), channels, separable, strict=True)
        self.blocks = nn.ModuleList(
            UpBlock(*side, separable=is_separable) for *side, is_separable in sides
        )

    def forward(
        self, bottom: Tensor, skips: Sequence[Tensor], boundaries: Sequence[Tensor]
    ) -> Tensor:
        """Return the features on the grid of the finest skip; skips and boundaries finest first."""
        x = bottom
        sides = zip(self.blocks, reversed(skips), reversed(boundaries), strict=True)
        for block, skip, boundary in sides:
            x = block(x, skip, boundary)
        return x
