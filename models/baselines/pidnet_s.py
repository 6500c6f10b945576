"""PIDNet-S: semantic segmentation from RGB alone.

Paper: Xu, Xiong, Bhattacharyya, "PIDNet: A Real-time Semantic Segmentation Network Inspired by PID
Controllers", CVPR 2023, Figures 4 to 7 and Table 2. The heads on the detail and boundary branches,
which the authors add for training, are left out.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.residual import (
    BasicBlock,
    Bottleneck,
    PoolingPyramid,
    basic_stage,
    normed,
    refinement,
)
from models.blocks import conv_bn, pad_to_multiple, upsample
from models.network import Network, NetworkConfig, NetworkOutput, initialise

_CHANNELS = 32
_CONTEXT = 96
_HEAD = 128


class PIDNetS(Network):
    """Detail (P) and boundary (D) branches at an eighth of the image, context (I) on coarser grids.

    The stages end without ReLU; the layers that read their features apply it.

    Attributes:
        stride: the last stage's grid is half as fine; it rounds up.
    """

    heads = ("semantic",)
    stride = 32
    semantic_stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        c = _CHANNELS
        self.stem = nn.Sequential(
            *(nn.Conv2d(3, c, 3, 2, 1), nn.BatchNorm2d(c), nn.ReLU(inplace=True)),
            *(nn.Conv2d(c, c, 3, 2, 1), nn.BatchNorm2d(c), nn.ReLU(inplace=True)),
        )
        self.stage1 = basic_stage(c, c)
        self.stage2 = basic_stage(c, 2 * c, stride=2)
        self.context3 = basic_stage(2 * c, 4 * c, count=3, stride=2)
        self.context4 = basic_stage(4 * c, 8 * c, count=3, stride=2)
        # There is no ReLU between these, as in the authors' code; the figures leave it open.
        self.context5 = nn.Sequential(Bottleneck(8 * c, 8 * c, stride=2), Bottleneck(16 * c, 8 * c))
        self.pyramid = ParallelPyramidContext(16 * c, _CONTEXT, 4 * c)
        self.detail3 = basic_stage(2 * c, 2 * c)
        self.detail4 = basic_stage(2 * c, 2 * c)
        self.detail5 = Bottleneck(2 * c, 2 * c)
        self.up3 = conv_bn(4 * c, 2 * c, kernel=1)
        self.up4 = conv_bn(8 * c, 2 * c, kernel=1)
        self.guide3 = AttentionGuide(2 * c, c)
        self.guide4 = AttentionGuide(2 * c, c)
        self.boundary3 = BasicBlock(2 * c, c)
        self.boundary4 = Bottleneck(c, c)
        self.boundary5 = Bottleneck(2 * c, 2 * c)
        self.difference3 = conv_bn(4 * c, c)
        self.difference4 = conv_bn(8 * c, 2 * c)
        self.fuse = BoundaryGuide(4 * c)
        self.refine = refinement(4 * c, _HEAD)
        self.semantic_head = nn.Conv2d(_HEAD, config.num_classes, 1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on an eighth of the image's grid, see `Network.predict_coarse`."""
        x = pad_to_multiple(self.normalise_rgb(rgb), self.stride)
        x = F.relu(self.stage2(F.relu(self.stage1(self.stem(x)))))
        detail, boundary = self.detail3(x), self.boundary3(x)
        x = F.relu(self.context3(x))
        detail = self.guide3(detail, upsample(self.up3(x), factor=2))
        boundary = boundary + upsample(self.difference3(x), factor=2)
        detail, boundary = self.detail4(F.relu(detail)), self.boundary4(F.relu(boundary))
        x = F.relu(self.context4(x))
        detail = self.guide4(detail, upsample(self.up4(x), factor=4))
        boundary = boundary + upsample(self.difference4(x), factor=4)
        detail, boundary = self.detail5(F.relu(detail)), self.boundary5(F.relu(boundary))
        context = self.pyramid(self.context5(x))
        context = upsample(context, size=(detail.shape[2], detail.shape[3]))
        fused = self.fuse(detail, context, boundary)
        return NetworkOutput(semantic_logits=self.semantic_head(self.refine(fused)))


class AttentionGuide(nn.Module):
    """The paper's Pag: context where it is like the detail, detail elsewhere. All (N, C, H, W).

    The context is upsampled to the detail's size before the comparison, not after: the 1x1
    convolution and the upsampling commute.
    """

    def __init__(self, channels: int, narrow: int) -> None:
        super().__init__()
        self.embed_detail = conv_bn(channels, narrow, kernel=1)
        self.embed_context = conv_bn(channels, narrow, kernel=1)

    def forward(self, detail: Tensor, context: Tensor) -> Tensor:
        """Blend detail and context by their similarity at each pixel."""
        alike = self.embed_detail(detail) * self.embed_context(context)
        share = torch.sigmoid(alike.sum(dim=1, keepdim=True))
        return (1.0 - share) * detail + share * context


class ParallelPyramidContext(PoolingPyramid):
    """The paper's PAPPM: all means are processed at once."""

    def __init__(self, in_channels: int, channels: int, out_channels: int) -> None:
        process = normed(nn.Conv2d(4 * channels, 4 * channels, 3, padding=1, groups=4, bias=False))
        super().__init__(in_channels, channels, out_channels, process)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H, W)."""
        finest, *means = self.pool(x)
        processed = self.process(torch.cat([mean + finest for mean in means], dim=1))
        out: Tensor = self.project(torch.cat((finest, processed), dim=1)) + self.shortcut(x)
        return out


class BoundaryGuide(nn.Module):
    """The paper's light Bag: detail at boundaries, context elsewhere. All (N, C, H, W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.detail = conv_bn(channels, channels, kernel=1)
        self.context = conv_bn(channels, channels, kernel=1)

    def forward(self, detail: Tensor, context: Tensor, boundary: Tensor) -> Tensor:
        """Fuse the three branches."""
        edge = torch.sigmoid(boundary)
        out: Tensor = self.detail((1.0 - edge) * context + detail) + self.context(
            context + edge * detail
        )
        return out
