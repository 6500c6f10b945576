"""Sparse-to-dense: depth completion from RGB and LiDAR.

Paper: Ma, Karaman, "Sparse-to-Dense: Depth Prediction from Sparse Depth Samples and a Single
Image", ICRA 2018, Figure 3, with ResNet-18 and the decoder "deconv3".
"""

from itertools import pairwise

import torch
from torch import Tensor, nn

from models.baselines.residual import BasicBlock
from models.blocks import ConvBNReLU, conv_bn, pad_to_multiple, up_conv_bn_relu
from models.network import Network, NetworkConfig, NetworkOutput, initialise

# Channels of ResNet-18's stages; each has two blocks (He et al. 2016).
_STAGES = (64, 128, 256, 512)
_DECODER = (256, 128, 64, 32, 16)


class SparseToDense(Network):
    """ResNet-18 on colours and depth in metres, and four upsampling transposed convolutions."""

    heads = ("depth",)
    stride = 32
    depth_stride = 2

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        layers: list[nn.Module] = [
            *ConvBNReLU(4, _STAGES[0], kernel=7, stride=2),
            nn.MaxPool2d(3, 2, padding=1),
        ]
        in_channels = _STAGES[0]
        for channels in _STAGES:
            stride = 1 if channels == in_channels else 2
            layers += [BasicBlock(in_channels, channels, stride=stride), nn.ReLU()]
            layers += [BasicBlock(channels, channels), nn.ReLU()]
            in_channels = channels
        self.encoder = nn.Sequential(*layers, *conv_bn(in_channels, _DECODER[0], kernel=1))
        ups: list[nn.Module] = []
        for in_channels, channels in pairwise(_DECODER):
            ups += up_conv_bn_relu(in_channels, channels, bias=False)
        self.decoder = nn.Sequential(*ups)
        self.depth_head = nn.Conv2d(_DECODER[-1], 1, 3, padding=1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on half the image's grid, see `Network.predict_coarse`."""
        depth, _ = self.normalise_depth(sparse_depth)
        x = torch.cat((self.normalise_rgb(rgb), depth * self.config.max_depth_m), dim=1)
        x = self.encoder(pad_to_multiple(x, self.stride))
        answer = self.depth_head(self.decoder(x))
        # The output is linear; it is clamped to the range in evaluation only.
        return NetworkOutput(depths=(answer if self.training else answer.clamp(0, 1),))
