"""The boundary decoder (paper, section 2.1.2 and Figure 2b)."""

import torch
from torch import Tensor, nn

from models.blocks import ConvBNReLU, upsample
from models.ssdnet_config import EncoderDecoderConfig


class BoundaryDecoder(nn.Module):
    """A side output on every skip, and their fusion into one boundary map.

    Side i: 3x3 convolution to ``boundary_channels``, BN, ReLU, 1x1 to one logit; B_i = its sigmoid.
    Fusion: the logits are upsampled to the finest skip, concatenated, 1x1 to the logit of P_b.

    Args:
        config: of the network.
        skip_channels: of the skips, finest first.
    """

    def __init__(self, config: EncoderDecoderConfig, skip_channels: tuple[int, ...]) -> None:
        super().__init__()
        self.padded, channels = config.padded, config.boundary_channels
        self.sides = nn.ModuleList(
            nn.Sequential(ConvBNReLU(in_channels, channels), nn.Conv2d(channels, 1, 1))
            for in_channels in skip_channels
        )
        self.fuse = nn.Conv2d(len(skip_channels), 1, 1)

    def forward(self, skips: list[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Return the fused logits (N, 1, h, w) and the side logits, finest first."""
        sides = [side(skip) for side, skip in zip(self.sides, skips, strict=True)]
        size = (skips[0].shape[2], skips[0].shape[3])
        upsampled = [
            upsample(logit, factor=2**index) if self.padded else upsample(logit, size=size)
            for index, logit in enumerate(sides)
        ]
        return self.fuse(torch.cat(upsampled, dim=1)), sides
