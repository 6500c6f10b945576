"""VGG16's convolutions, the backbone of FCN8s, BaCNN and DeepLab.

Paper: Simonyan, Zisserman, "Very Deep Convolutional Networks for Large-Scale Image Recognition",
ICLR 2015, configuration D. Batch normalisation is added here: without it the network hardly learns
from random weights, and export fuses it into the convolutions.
"""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU

# Channels and convolutions of each block.
VGG16_BLOCKS = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))


class VGG16(nn.Module):
    """The five blocks, each followed by 2x2 max-pooling that rounds up."""

    def __init__(self) -> None:
        super().__init__()
        blocks, in_channels = [], 3
        for channels, count in VGG16_BLOCKS:
            blocks.append(vgg_block(in_channels, channels, count))
            in_channels = channels
        self.blocks = nn.ModuleList(blocks)

    def forward(
        self, x: Tensor, boundaries: Sequence[Tensor] = ()
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Return the features of each block, finest first, before and after pooling.

        x: (N, 3, H, W). boundaries: B in 0..1, (N, 1, h, w) on the grid of each block's input, or
        empty. With boundaries each block's input is multiplied by 1 - B, which makes its first
        convolution boundary-aware (`models.blocks.BaConv`).
        """
        features, pooled = [], []
        for index, block in enumerate(self.blocks):
            if boundaries:
                x = x * (1.0 - boundaries[index])
            features.append(block(x))
            x = F.max_pool2d(features[-1], 2, ceil_mode=True)
            pooled.append(x)
        return features, pooled


def vgg_block(
    in_channels: int, out_channels: int, count: int, *, dilation: int = 1
) -> nn.Sequential:
    """Return a sequence of 3x3 convolutions, each with batch normalisation and ReLU."""
    layers: list[nn.Module] = []
    for _ in range(count):
        layers += ConvBNReLU(in_channels, out_channels, dilation=dilation)
        in_channels = out_channels
    return nn.Sequential(*layers)
