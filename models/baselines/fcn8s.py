"""FCN8s: semantic segmentation from RGB alone.

Paper: Long, Shelhamer, Darrell, "Fully Convolutional Networks for Semantic Segmentation", CVPR
2015, section 4.2. Pooling rounds up where the paper pads the image by 100 pixels, and scores are
upsampled bilinearly, as the paper's deconvolutions are initialised.
"""

import torch
from torch import Tensor, nn

from models.baselines.vgg16 import VGG16
from models.blocks import ConvBNReLU, upsample
from models.network import Network, NetworkConfig, NetworkOutput, initialise

_WIDE = 4096


class FCN8s(Network):
    """A fully convolutional VGG16 that adds its scores at 1/32, 1/16 and 1/8 of the image."""

    heads: tuple[str, ...] = ("semantic",)
    stride = 32
    semantic_stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.backbone = VGG16()
        self.classify = nn.Sequential(
            ConvBNReLU(512, _WIDE, kernel=7),
            nn.Dropout(0.5),
            ConvBNReLU(_WIDE, _WIDE, kernel=1),
            nn.Dropout(0.5),
        )
        self.semantic_head = nn.Conv2d(_WIDE, config.num_scores, 1)
        self.score_16 = nn.Conv2d(512, config.num_scores, 1)
        self.score_8 = nn.Conv2d(256, config.num_scores, 1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on an eighth of the image's grid, see `Network.predict_coarse`."""
        _, pooled = self.backbone(self.normalise_rgb(rgb))
        return NetworkOutput(semantic_logits=self.score(pooled))

    def score(self, pooled: list[Tensor]) -> Tensor:
        """Scores (N, C, ceil(H / 8), ceil(W / 8)) of VGG16's pooled features."""
        classified = self.classify(pooled[4])
        with torch.autocast("cpu", enabled=False):
            # In bfloat16 PyTorch 2.13 damages the memory of a CPU with the gradient of so few
            # channels of so many.
            scores: Tensor = self.semantic_head(classified.float())
        for head, features in ((self.score_16, pooled[3]), (self.score_8, pooled[2])):
            height, width = features.shape[2], features.shape[3]
            # Pooling rounded up: the last row and column of an odd grid have one child.
            scores = head(features) + upsample(scores)[:, :, :height, :width]
        return scores
