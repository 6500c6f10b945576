"""Fast-SCNN: semantic segmentation from RGB alone.

Paper: Poudel, Liwicki, Cipolla, "Fast-SCNN: Fast Semantic Segmentation Network", BMVC 2019, Table 1
and Figure 2. The losses at inner layers, which the authors add for training, are left out.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, adaptive_mean, pad_to_multiple, upsample
from models.network import Network, NetworkConfig, NetworkOutput, initialise

# Channels, first stride and repetitions of the inverted residual stages.
_STAGES = ((64, 2, 3), (96, 2, 3), (128, 1, 3))
_EXPANSION = 6
_POOLED_SIZES = (1, 2, 3, 6)


class FastSCNN(Network):
    """Learning to downsample, a global feature extractor, their fusion, and a classifier."""

    heads = ("semantic",)
    stride = 32
    semantic_stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.downsample = nn.Sequential(
            ConvBNReLU(3, 32, stride=2), _separable(32, 48, stride=2), _separable(48, 64, stride=2)
        )
        blocks: list[nn.Module] = []
        in_channels = 64
        for channels, stride, count in _STAGES:
            for index in range(count):
                blocks.append(
                    InvertedResidual(in_channels, channels, stride=1 if index else stride)
                )
                in_channels = channels
        self.extract = nn.Sequential(*blocks, PyramidPooling(in_channels))
        self.refine = _depthwise(in_channels, dilation=4)
        self.project_coarse = nn.Sequential(nn.Conv2d(in_channels, 128, 1), nn.BatchNorm2d(128))
        self.project_fine = nn.Sequential(nn.Conv2d(64, 128, 1), nn.BatchNorm2d(128))
        self.classify = nn.Sequential(_separable(128, 128), _separable(128, 128), nn.Dropout(0.1))
        self.semantic_head = nn.Conv2d(128, config.num_scores, 1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on an eighth of the image's grid, see `Network.predict_coarse`."""
        x = pad_to_multiple(self.normalise_rgb(rgb), self.stride)
        fine = self.downsample(x)
        coarse = self.refine(upsample(self.extract(fine), factor=4))
        fused = F.relu(self.project_coarse(coarse) + self.project_fine(fine))
        return NetworkOutput(semantic_logits=self.semantic_head(self.classify(fused)))


class InvertedResidual(nn.Module):
    """MobileNetV2's bottleneck (Sandler et al. 2018): widen, depthwise, narrow, add."""

    def __init__(self, in_channels: int, out_channels: int, *, stride: int) -> None:
        super().__init__()
        wide = in_channels * _EXPANSION
        self.layers = nn.Sequential(
            ConvBNReLU(in_channels, wide, kernel=1),
            _depthwise(wide, stride=stride),
            nn.Conv2d(wide, out_channels, 1, bias=False),
            nn.BatchNorm2d(out_channels),
        )
        self.adds = stride == 1 and in_channels == out_channels

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', ceil(H / stride), ceil(W / stride))."""
        out: Tensor = self.layers(x)
        return x + out if self.adds else out


class PyramidPooling(nn.Module):
    """Means over coarser and coarser grids beside the features (Zhao et al. 2017)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        narrow = channels // len(_POOLED_SIZES)
        self.levels = nn.ModuleList(ConvBNReLU(channels, narrow, kernel=1) for _ in _POOLED_SIZES)
        self.project = ConvBNReLU(2 * channels, channels, kernel=1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> same."""
        size = (x.shape[2], x.shape[3])
        pooled = [
            upsample(level(adaptive_mean(x, cells)), size=size)
            for cells, level in zip(_POOLED_SIZES, self.levels, strict=True)
        ]
        out: Tensor = self.project(torch.cat((x, *pooled), dim=1))
        return out


def _depthwise(channels: int, *, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return ConvBNReLU(channels, channels, stride=stride, dilation=dilation, groups=channels)


def _separable(in_channels: int, out_channels: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        _depthwise(in_channels, stride=stride), ConvBNReLU(in_channels, out_channels, kernel=1)
    )
