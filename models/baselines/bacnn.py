"""BaCNN: semantics and boundaries from RGB alone.

Paper: Zou, He, Wang, Bi, Shang, "Boundary-Aware CNN for Semantic Segmentation", IEEE Access 2019:
a boundary network, then an FCN8s whose first convolution of each block is boundary-aware. The paper
does not say how the boundary gets to the coarser blocks. Here it is max-pooled, so that no boundary
is lost.
Like that of Xie and Tu (2015), the boundary network has a side output on each block and fuses them.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.fcn8s import FCN8s
from models.baselines.vgg16 import VGG16, VGG16_BLOCKS
from models.blocks import upsample
from models.network import NetworkConfig, NetworkOutput, initialise


class BaCNN(FCN8s):
    """A boundary network, and FCN8s gated by its boundaries."""

    heads = ("semantic", "boundary")

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.boundary = BoundaryNetwork()
        self.boundary.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict boundaries at full size, classes at an eighth; see `Network.predict_coarse`."""
        x = self.normalise_rgb(rgb)
        boundary_logits = self.boundary(x)
        boundaries = [torch.sigmoid(boundary_logits)]
        for _ in VGG16_BLOCKS[1:]:
            boundaries.append(F.max_pool2d(boundaries[-1], 2, ceil_mode=True))
        _, pooled = self.backbone(x, boundaries)
        return NetworkOutput(
            semantic_logits=self.score(pooled),
            boundary_logits=boundary_logits,
        )


class BoundaryNetwork(nn.Module):
    """VGG16 with one logit per pixel from each block, fused at full size."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = VGG16()
        self.sides = nn.ModuleList(nn.Conv2d(channels, 1, 1) for channels, _ in VGG16_BLOCKS)
        self.fuse = nn.Conv2d(len(VGG16_BLOCKS), 1, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, 3, H, W) -> logits (N, 1, H, W)."""
        height, width = x.shape[2], x.shape[3]
        features, _ = self.backbone(x)
        sides = [side(feature) for side, feature in zip(self.sides, features, strict=True)]
        upsampled = [
            upsample(logit, factor=2**index)[:, :, :height, :width]
            for index, logit in enumerate(sides)
        ]
        out: Tensor = self.fuse(torch.cat(upsampled, dim=1))
        return out
