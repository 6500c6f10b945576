"""ERFNet: semantic segmentation from RGB alone.

Paper: Romera, Alvarez, Bergasa, Arroyo, "ERFNet: Efficient Residual Factorized ConvNet for
Real-Time Semantic Segmentation", IEEE Transactions on Intelligent Transportation Systems 2018,
Table 1 and Figure 2c.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import extend_to_multiple, up_conv_bn_relu
from models.network import Network, NetworkConfig, NetworkOutput, initialise

# Dilations of the residual blocks at an eighth of the image.
_DILATIONS = (2, 4, 8, 16, 2, 4, 8, 16)


class ERFNet(Network):
    """Residual blocks of one-dimensional convolutions, down to an eighth and up again."""

    heads = ("semantic",)
    stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.encoder = nn.Sequential(
            Downsampler(3, 16),
            Downsampler(16, 64),
            *(Factorized(64, dropout=0.03) for _ in range(5)),
            Downsampler(64, 128),
            *(Factorized(128, dilation=dilation, dropout=0.3) for dilation in _DILATIONS),
        )
        self.decoder = nn.Sequential(
            up_conv_bn_relu(128, 64),
            Factorized(64),
            Factorized(64),
            up_conv_bn_relu(64, 16),
            Factorized(16),
            Factorized(16),
        )
        self.semantic_head = nn.ConvTranspose2d(16, config.num_scores, 2, 2)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict at the padded image's size, see `Network.predict_coarse`."""
        x = extend_to_multiple(self.normalise_rgb(rgb), self.stride)
        return NetworkOutput(semantic_logits=self.semantic_head(self.decoder(self.encoder(x))))


class Downsampler(nn.Module):
    """A strided convolution beside max-pooling: (N, C, H, W) -> (N, C', H / 2, W / 2)."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(in_channels, out_channels - in_channels, 3, 2, 1)
        self.norm = nn.BatchNorm2d(out_channels)

    def forward(self, x: Tensor) -> Tensor:
        """Halve the grid."""
        return F.relu(self.norm(torch.cat((self.conv(x), F.max_pool2d(x, 2)), dim=1)))


class Factorized(nn.Module):
    """Non-bottleneck-1D: 3x1, 1x3, and both dilated, added to the input: (N, C, H, W) -> same."""

    def __init__(self, channels: int, *, dilation: int = 1, dropout: float = 0.0) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for step in (1, dilation):
            layers += [
                nn.Conv2d(channels, channels, (3, 1), padding=(step, 0), dilation=(step, 1)),
                nn.ReLU(inplace=True),
                nn.Conv2d(channels, channels, (1, 3), padding=(0, step), dilation=(1, step)),
                nn.BatchNorm2d(channels),
                nn.ReLU(inplace=True),
            ]
        layers[-1] = nn.Dropout2d(dropout)  # the last ReLU comes after the sum
        self.layers = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        """Return the input plus the output of the layers."""
        return F.relu(x + self.layers(x))
