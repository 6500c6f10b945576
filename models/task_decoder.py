"""The decoder of semantics and of depth (paper, section 2.1.3 and Figure 3)."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import BaConv, ConvBNReLU, upsample
from models.ssdnet_config import SSDNetConfig


class UpBlock(nn.Module):
    """Upsample, join the skip, boundary-aware convolution.

    "concat" is the paper's: concat(up(x), S_i), BaConv 3x3, BN, ReLU, conv 3x3, BN, ReLU.
    "add" is the lite form: up(x) + 1x1(S_i), BaConv 3x3, BN, ReLU.
    """

    def __init__(self, in_channels: int, skip_channels: int, channels: int, fusion: str) -> None:
        super().__init__()
        self.fusion = fusion
        if fusion == "concat":
            self.baconv = BaConv(in_channels + skip_channels, channels)
            self.conv: nn.Module = ConvBNReLU(channels, channels)
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

    def forward(self, x: Tensor, skip: Tensor, boundary: Tensor | None, *, exact: bool) -> Tensor:
        """Join x (N, C, h, w), skip (N, S, H, W) and boundary (N, 1, H, W) to (N, C', H, W)."""
        if self.fusion == "add":
            x = self.reduce(x)  # before upsampling: a quarter of the work
        x = upsample(x) if exact else upsample(x, size=(skip.shape[2], skip.shape[3]))
        x = torch.cat([x, skip], dim=1) if self.fusion == "concat" else x + self.project(skip)
        out: Tensor = self.conv(F.relu(self.norm(self.baconv(x, boundary))))
        return out


class TaskDecoder(nn.Module):
    """UpBlocks from the bottom to the finest skip."""

    def __init__(
        self, config: SSDNetConfig, skip_channels: tuple[int, ...], bottom_channels: int
    ) -> None:
        super().__init__()
        blocks = []
        in_channels = bottom_channels
        for skip, channels in zip(reversed(skip_channels), config.decoder_channels, strict=True):
            blocks.append(UpBlock(in_channels, skip, channels, config.skip_fusion))
            in_channels = channels
        self.blocks = nn.ModuleList(blocks)

    def forward(
        self,
        bottom: Tensor,
        skips: list[Tensor],
        boundaries: list[Tensor] | list[None],
        *,
        exact: bool,
    ) -> list[Tensor]:
        """Return the features after each UpBlock, finest first (as the skips are)."""
        features = []
        x = bottom
        for block, skip, boundary in zip(
            self.blocks, reversed(skips), reversed(boundaries), strict=True
        ):
            x = block(x, skip, boundary, exact=exact)
            features.append(x)
        return features[::-1]
