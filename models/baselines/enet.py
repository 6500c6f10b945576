"""ENet: semantic segmentation from RGB alone.

Paper: Paszke, Chaurasia, Kim, Culurciello, "ENet: A Deep Neural Network Architecture for Real-Time
Semantic Segmentation", 2016, Table 1 and Figure 2.

What the paper leaves open follows the implementations with 0.35M parameters: a bottleneck works on
a quarter of its input's channels, and upsampling bottlenecks use transposed convolutions of 2x2.
The authors' code uses a quarter of the output's channels, and 3x3.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.max_unpooling import max_mask, max_unpool
from models.blocks import extend_to_multiple
from models.network import Network, NetworkConfig, NetworkOutput, initialise

# A bottleneck works on this share of the channels.
_SHARE = 4
# Kernel and dilation of the bottlenecks of stage 2, repeated in stage 3; 5 means 5x1 and 1x5.
_CONTEXT = ((3, 1), (3, 2), (5, 1), (3, 4), (3, 1), (3, 8), (5, 1), (3, 16))


class ENet(Network):
    """Bottlenecks that go down to an eighth of the image, and up again by max-unpooling."""

    heads = ("semantic",)
    stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.initial = InitialBlock(16)
        self.down1 = DownBottleneck(16, 64, dropout=0.01)
        self.stage1 = nn.Sequential(*(Bottleneck(64, dropout=0.01) for _ in range(4)))
        self.down2 = DownBottleneck(64, 128, dropout=0.1)
        self.stage2, self.stage3 = (
            nn.Sequential(
                *(
                    Bottleneck(128, kernel=kernel, dilation=dilation, dropout=0.1)
                    for kernel, dilation in _CONTEXT
                )
            )
            for _ in range(2)
        )
        self.up4 = UpBottleneck(128, 64)
        self.stage4 = nn.Sequential(*(Bottleneck(64, dropout=0.1, decodes=True) for _ in range(2)))
        self.up5 = UpBottleneck(64, 16)
        self.stage5 = Bottleneck(16, dropout=0.1, decodes=True)
        self.semantic_head = nn.ConvTranspose2d(16, config.num_scores, 3, 2, 1, output_padding=1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict at the padded image's size, see `Network.predict_coarse`."""
        x = self.initial(extend_to_multiple(self.normalise_rgb(rgb), self.stride))
        x, mask1 = self.down1(x)
        x, mask2 = self.down2(self.stage1(x))
        x = self.stage3(self.stage2(x))
        x = self.stage4(self.up4(x, mask2))
        x = self.stage5(self.up5(x, mask1))
        return NetworkOutput(semantic_logits=self.semantic_head(x))


class InitialBlock(nn.Module):
    """A strided convolution beside the max-pooled image: (N, 3, H, W) -> (N, C, H / 2, W / 2)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, channels - 3, 3, 2, 1, bias=False)
        self.finish = nn.Sequential(nn.BatchNorm2d(channels), nn.PReLU(channels))

    def forward(self, x: Tensor) -> Tensor:
        """Halve the image."""
        out: Tensor = self.finish(torch.cat((self.conv(x), F.max_pool2d(x, 2)), dim=1))
        return out


class Bottleneck(nn.Module):
    """1x1, a wider convolution, 1x1, added to the input: (N, C, H, W) -> same."""

    def __init__(
        self,
        channels: int,
        *,
        dropout: float,
        kernel: int = 3,
        dilation: int = 1,
        decodes: bool = False,
    ) -> None:
        super().__init__()
        narrow = channels // _SHARE
        if kernel == 3:
            around = [nn.Conv2d(narrow, narrow, 3, 1, dilation, dilation, bias=False)]
        else:
            around = [
                nn.Conv2d(narrow, narrow, (kernel, 1), padding=(kernel // 2, 0), bias=False),
                nn.Conv2d(narrow, narrow, (1, kernel), padding=(0, kernel // 2), bias=False),
            ]
        squeeze = nn.Conv2d(channels, narrow, 1, bias=False)
        self.layers = _bottleneck(squeeze, around, channels, dropout=dropout, decodes=decodes)
        self.activation = _activation(channels, decodes)

    def forward(self, x: Tensor) -> Tensor:
        """Return the input plus the output of the layers."""
        out: Tensor = self.activation(x + self.layers(x))
        return out


class DownBottleneck(nn.Module):
    """Halve the size: the bottleneck's first convolution has a stride, and its input is pooled."""

    def __init__(self, in_channels: int, out_channels: int, *, dropout: float) -> None:
        super().__init__()
        narrow = in_channels // _SHARE
        self.more_channels = out_channels - in_channels
        squeeze = nn.Conv2d(in_channels, narrow, 2, 2, bias=False)
        around = [nn.Conv2d(narrow, narrow, 3, padding=1, bias=False)]
        self.layers = _bottleneck(squeeze, around, out_channels, dropout=dropout)
        self.activation = nn.PReLU(out_channels)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(N, C, H, W) -> (N, C', H / 2, W / 2), and the positions of the pooled values."""
        pooled = F.pad(F.max_pool2d(x, 2), (0, 0, 0, 0, 0, self.more_channels))
        return self.activation(pooled + self.layers(x)), max_mask(x)


class UpBottleneck(nn.Module):
    """Double the size: a transposed convolution, added to the unpooled input."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        narrow = in_channels // _SHARE
        self.shortcut = nn.Sequential(
            nn.Conv2d(in_channels, out_channels, 1, bias=False), nn.BatchNorm2d(out_channels)
        )
        squeeze = nn.Conv2d(in_channels, narrow, 1, bias=False)
        around = [nn.ConvTranspose2d(narrow, narrow, 2, 2, bias=False)]
        self.layers = _bottleneck(squeeze, around, out_channels, dropout=0.1, decodes=True)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', 2 H, 2 W); the mask is that of the stage with C' channels."""
        return F.relu(max_unpool(self.shortcut(x), mask) + self.layers(x))


def _bottleneck(
    squeeze: nn.Conv2d,
    around: Sequence[nn.Module],
    out_channels: int,
    *,
    dropout: float,
    decodes: bool = False,
) -> nn.Sequential:
    """Reduce to fewer channels, convolve there, and expand to the output's channels by a 1x1."""
    narrow = squeeze.out_channels
    return nn.Sequential(
        squeeze,
        *_normed(narrow, decodes),
        *around,
        *_normed(narrow, decodes),
        nn.Conv2d(narrow, out_channels, 1, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.Dropout2d(dropout),
    )


def _normed(channels: int, decodes: bool) -> list[nn.Module]:
    return [nn.BatchNorm2d(channels), _activation(channels, decodes)]


def _activation(channels: int, decodes: bool) -> nn.Module:
    """PReLU in the encoder, ReLU in the decoder (section 4)."""
    return nn.ReLU() if decodes else nn.PReLU(channels)
