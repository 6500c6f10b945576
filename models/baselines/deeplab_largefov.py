"""DeepLab-LargeFOV: semantic segmentation from RGB alone.

Paper: Chen, Papandreou, Kokkinos, Murphy, Yuille, "Semantic Image Segmentation with Deep
Convolutional Nets and Fully Connected CRFs", ICLR 2015, section 4.2, in its form with 1024 channels
and a rate of 12. The CRF, which smooths the answers of the network afterwards, is left out.
"""

from torch import Tensor, nn

from models.baselines.vgg16 import VGG16_BLOCKS, vgg_block
from models.blocks import ConvBNReLU
from models.network import Network, NetworkConfig, NetworkOutput, initialise

_WIDE = 1024
_RATE = 12
# Stride of the pooling after each block of VGG16.
_POOL_STRIDES = (2, 2, 2, 1, 1)
# Dilation of each block: the last block sees as far as if the pooling before it had a stride.
_DILATIONS = (1, 1, 1, 1, 2)


class DeepLabLargeFOV(Network):
    """VGG16 that stays at an eighth of the image, and a convolution with a large field of view."""

    heads = ("semantic",)
    stride = 8
    semantic_stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        layers: list[nn.Module] = []
        in_channels = 3
        for (channels, count), dilation, stride in zip(
            VGG16_BLOCKS, _DILATIONS, _POOL_STRIDES, strict=True
        ):
            layers += [
                vgg_block(in_channels, channels, count, dilation=dilation),
                nn.MaxPool2d(3, stride, padding=1),
            ]
            in_channels = channels
        self.backbone = nn.Sequential(*layers, nn.AvgPool2d(3, 1, padding=1))
        self.classify = nn.Sequential(
            vgg_block(in_channels, _WIDE, 1, dilation=_RATE),
            nn.Dropout(0.5),
            *ConvBNReLU(_WIDE, _WIDE, kernel=1),
            nn.Dropout(0.5),
        )
        self.semantic_head = nn.Conv2d(_WIDE, config.num_scores, 1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on an eighth of the image's grid, see `Network.predict_coarse`."""
        x = self.backbone(self.normalise_rgb(rgb))
        return NetworkOutput(semantic_logits=self.semantic_head(self.classify(x)))
