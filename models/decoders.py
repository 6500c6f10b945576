"""The decoders of boundaries, and of classes and depth (paper, sections 2.1.2 and 2.1.3).

`SSDNet` and `SSDNetLite` share both decoders and differ in the blocks of the task decoders:
`ConcatUpBlock` is the paper's. `AddUpBlock` departs from it, because channels that are concatenated
cost a convolution of twice the size.
"""

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import BaConv, ConvBNReLU, conv_bn, separable_conv, shortcut, upsample


class BoundaryDecoder(nn.Module):
    """A side output on every skip, and their fusion into one boundary map (Figure 2b).

    Side i: 3x3 convolution, BN, ReLU, 1x1 to one logit; B_i = its sigmoid. Fusion: the logits are
    upsampled to the finest skip, concatenated, 1x1 to the logit of P_b.

    Args:
        skip_channels: channels of each skip, finest first.
        channels: channels of a side output.
        separable: whether the 3x3 convolutions are separable.
        halved: whether each skip has exactly half the size of the finer one. An exported graph then
            needs no operations that compute sizes.
    """

    def __init__(
        self,
        skip_channels: Sequence[int],
        channels: int,
        *,
        separable: bool = False,
        halved: bool = False,
    ) -> None:
        super().__init__()
        self.halved = halved
        self.sides = nn.ModuleList(_side(skip, channels, separable) for skip in skip_channels)
        self.fuse = nn.Conv2d(len(skip_channels), 1, 1)

    def forward(self, skips: Sequence[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Return the fused logits (N, 1, h, w) and the side logits, finest first."""
        sides = [side(skip) for side, skip in zip(self.sides, skips, strict=True)]
        size = None if self.halved else (skips[0].shape[2], skips[0].shape[3])
        same = [upsample(x, factor=2**level, size=size) for level, x in enumerate(sides)]
        return self.fuse(torch.cat(same, dim=1)), sides


def _side(in_channels: int, channels: int, separable: bool) -> nn.Sequential:
    features = ConvBNReLU(in_channels, channels)
    if separable:
        features[0] = separable_conv(in_channels, channels)
    return nn.Sequential(features, nn.Conv2d(channels, 1, 1))


class TaskDecoder(nn.Module):
    """Up-blocks from the bottom to the finest skip (Figure 3).

    Args:
        blocks: a block for each skip, coarsest first.
    """

    def __init__(self, blocks: Iterable[nn.Module]) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)

    def forward(
        self, bottom: Tensor, skips: Sequence[Tensor], boundaries: Sequence[Tensor | None]
    ) -> list[Tensor]:
        """Return the features after each block; skips, boundaries and features finest first."""
        features = []
        x = bottom
        sides = zip(self.blocks, reversed(skips), reversed(boundaries), strict=True)
        for block, skip, boundary in sides:
            x = block(x, skip, boundary)
            features.append(x)
        return features[::-1]


class ConcatUpBlock(nn.Module):
    """The paper's block: concat(up(x), S_i), BaConv 3x3, BN, ReLU, conv 3x3, BN, ReLU."""

    def __init__(self, in_channels: int, skip_channels: int, channels: int) -> None:
        super().__init__()
        self.baconv = BaConv(in_channels + skip_channels, channels)
        self.norm = nn.BatchNorm2d(channels)
        self.conv = ConvBNReLU(channels, channels)

    def forward(self, x: Tensor, skip: Tensor, boundary: Tensor | None) -> Tensor:
        """Join x (N, C, h, w), skip (N, S, H, W) and boundary (N, 1, H, W) to (N, C', H, W)."""
        x = torch.cat([upsample(x, size=(skip.shape[2], skip.shape[3])), skip], dim=1)
        out: Tensor = self.conv(F.relu(self.norm(self.baconv(x, boundary))))
        return out


class AddUpBlock(nn.Module):
    """up(x) + 1x1(S_i), BaConv 3x3, BN, ReLU; the skip has twice the size of x.

    The encoder's features have no activation, and their magnitudes differ by stride: both are
    normalised before they are added.
    """

    def __init__(
        self, in_channels: int, skip_channels: int, channels: int, *, separable: bool = False
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
