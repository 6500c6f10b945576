"""The decoder of semantics and of depth (paper, section 2.1.3 and Figure 3)."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import BaConv, ConvBNReLU, conv_bn, shortcut, upsample
from models.ssdnet_config import EncoderDecoderConfig

#: How an UpBlock joins a skip.
Fusion = Literal["concat", "add"]


class UpBlock(nn.Module):
    """Upsample, join the skip, boundary-aware convolution.

    "concat" is the paper's: concat(up(x), S_i), BaConv 3x3, BN, ReLU, conv 3x3, BN, ReLU.
    "add" is the lite form: up(x) + 1x1(S_i), BaConv 3x3, BN, ReLU; S_i has twice the size of x,
    as with "concat" where ``padded``. With a ``linear`` encoder, whose features have no activation
    and differ in magnitude, both are normalised before they are added.
    """

    def __init__(
        self,
        in_channels: int,
        skip_channels: int,
        channels: int,
        fusion: Fusion,
        *,
        padded: bool = True,
        linear: bool = False,
    ) -> None:
        super().__init__()
        self.fusion, self.padded = fusion, padded
        if fusion == "concat":
            self.baconv = BaConv(in_channels + skip_channels, channels)
            self.conv: nn.Module = ConvBNReLU(channels, channels)
        else:
            self.reduce: nn.Module
            self.project: nn.Module
            if linear:
                self.reduce = shortcut(in_channels, channels, stride=1)
                self.project = conv_bn(skip_channels, channels, kernel=1)
            else:
                self.reduce = (
                    nn.Conv2d(in_channels, channels, 1, bias=False)
                    if in_channels != channels
                    else nn.Identity()
                )
                self.project = nn.Conv2d(skip_channels, channels, 1)
            self.baconv = BaConv(channels, channels)
            self.conv = nn.Identity()
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor, skip: Tensor, boundary: Tensor | None = None) -> Tensor:
        """Join x (N, C, h, w), skip (N, S, H, W) and boundary (N, 1, H, W) to (N, C', H, W)."""
        if self.fusion == "concat":
            size = None if self.padded else (skip.shape[2], skip.shape[3])
            x = torch.cat([upsample(x, size=size), skip], dim=1)
        else:  # reduced before upsampling: a quarter of the work
            x = upsample(self.reduce(x)) + self.project(skip)
        out: Tensor = self.conv(F.relu(self.norm(self.baconv(x, boundary))))
        return out


class _Unrefined(nn.Module):
    def forward(self, x: Tensor, skip: Tensor, boundary: Tensor | None = None) -> Tensor:
        return x


def refinement(
    in_channels: int, skip_channels: int, channels: int, *, linear: bool = False
) -> nn.Module:
    """Return one more UpBlock, to features of twice the size; without channels, nothing."""
    if not channels:
        return _Unrefined()
    return UpBlock(in_channels, skip_channels, channels, "add", linear=linear)


class TaskDecoder(nn.Module):
    """UpBlocks from the bottom to the finest skip."""

    def __init__(
        self,
        config: EncoderDecoderConfig,
        skip_channels: tuple[int, ...],
        bottom_channels: int,
        fusion: Fusion,
        *,
        linear: bool = False,
    ) -> None:
        super().__init__()
        channels = config.decoder_channels
        below = (bottom_channels, *channels[:-1])
        sides = zip(below, reversed(skip_channels), channels, strict=True)
        self.blocks = nn.ModuleList(
            UpBlock(*side, fusion, padded=config.padded, linear=linear) for side in sides
        )

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
