"""The boundary decoder (paper, section 2.1.2 and Figure 2b)."""

import torch
from torch import Tensor, nn

from models.blocks import boundary_side, upsample
from models.paper.config import SSDNetConfig


class BoundaryDecoder(nn.Module):
    """A side output on every skip, and their fusion into one boundary map.

    Side i: 3x3 convolution to ``boundary_channels``, BN, ReLU, 1x1 to one logit; B_i = its sigmoid.
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
