"""The decoders of boundaries, and of semantics and depth (paper, sections 2.1.2 and 2.1.3)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import BaConv, ConvBNReLU, boundary_side, upsample
from models.paper.config import SSDNetConfig


class BoundaryDecoder(nn.Module):
    """A side output on every skip, and their fusion into one boundary map (Figure 2b).

    Side i: 3x3 convolution to `boundary_channels`, BN, ReLU, 1x1 to one logit; B_i = its sigmoid.
    Fusion: the logits are upsampled to the finest skip, concatenated, 1x1 to the logit of P_b.
    """

    def __init__(self, config: SSDNetConfig) -> None:
        super().__init__()
        skips, channels = config.encoder_channels, config.boundary_channels
        self.sides = nn.ModuleList(boundary_side(skip, channels) for skip in skips)
        self.fuse = nn.Conv2d(len(skips), 1, 1)

    def forward(self, skips: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Return the fused logits (N, 1, h, w) and the side logits, finest first."""
        sides = [side(skip) for side, skip in zip(self.sides, skips, strict=True)]
        size = (skips[0].shape[2], skips[0].shape[3])
        return self.fuse(torch.cat([upsample(logit, size=size) for logit in sides], dim=1)), sides


class UpBlock(nn.Module):
    """concat(up(x), S_i), BaConv 3x3, BN, ReLU, conv 3x3, BN, ReLU."""

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


class TaskDecoder(nn.Module):
    """UpBlocks from the bottom to the finest skip (Figure 3)."""

    def __init__(self, config: SSDNetConfig) -> None:
        super().__init__()
        channels, skips = config.decoder_channels, config.encoder_channels
        below = (skips[-1], *channels[:-1])
        sides = zip(below, reversed(skips), channels, strict=True)
        self.blocks = nn.ModuleList(UpBlock(*side) for side in sides)

    def forward(
        self, bottom: Tensor, skips: list[Tensor], boundaries: Sequence[Tensor | None]
    ) -> list[Tensor]:
        """Return the features after each UpBlock, finest first (as the skips are)."""
        features = []
        x = bottom
        for block, skip, boundary in zip(
            self.blocks, reversed(skips), reversed(boundaries), strict=True
        ):
            x = block(x, skip, boundary)
            features.append(x)
        return features[::-1]
