"""DDRNet-23-slim: semantic segmentation from RGB alone.

Paper: Hong, Pan, Sun, Jia, "Deep Dual-resolution Networks for Real-time and Accurate Semantic
Segmentation of Road Scenes", 2021, Table 1 and Figure 4. The extra head on the fine branch, which
the authors add for training, is left out.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.residual import BasicBlock
from models.blocks import ConvBNReLU, conv_bn, pad_to_multiple, shortcut, upsample
from models.network import Network, NetworkConfig, NetworkOutput, initialise

_CHANNELS = 32
_FINE = 64
_CONTEXT = 128
_HEAD = 64


class DDRNet23Slim(Network):
    """A branch at an eighth of the image, a branch on coarser grids, and bridges between them.

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
        self.stem = nn.Sequential(ConvBNReLU(3, c, stride=2), ConvBNReLU(c, c, stride=2))
        self.stage1 = _basic_stage(c, c)
        self.stage2 = _basic_stage(c, 2 * c, stride=2)
        self.coarse3 = _basic_stage(2 * c, 4 * c, stride=2)
        self.coarse4 = _basic_stage(4 * c, 8 * c, stride=2)
        self.coarse5 = Bottleneck(8 * c, 8 * c, stride=2)
        self.fine3 = _basic_stage(2 * c, _FINE)
        self.fine4 = _basic_stage(_FINE, _FINE)
        self.fine5 = Bottleneck(_FINE, _FINE)
        self.up3 = conv_bn(4 * c, _FINE, kernel=1)
        self.up4 = conv_bn(8 * c, _FINE, kernel=1)
        self.down3 = conv_bn(_FINE, 4 * c, stride=2)
        self.down4 = nn.Sequential(
            ConvBNReLU(_FINE, 4 * c, stride=2), conv_bn(4 * c, 8 * c, stride=2)
        )
        self.context = PyramidContext(16 * c, _CONTEXT, 2 * _FINE)
        self.refine = nn.Sequential(
            nn.BatchNorm2d(2 * _FINE), nn.ReLU(), *ConvBNReLU(2 * _FINE, _HEAD)
        )
        self.semantic_head = nn.Conv2d(_HEAD, config.num_scores, 1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on an eighth of the image's grid, see `Network.predict_coarse`."""
        x = pad_to_multiple(self.normalise_rgb(rgb), self.stride)
        shared = F.relu(self.stage2(F.relu(self.stage1(self.stem(x)))))
        coarse, fine = self.coarse3(shared), self.fine3(shared)
        down, up = self.down3(F.relu(fine)), self.up3(F.relu(coarse))
        coarse, fine = F.relu(coarse + down), F.relu(fine + upsample(up, factor=2))
        coarse, fine = self.coarse4(coarse), self.fine4(fine)
        down, up = self.down4(F.relu(fine)), self.up4(F.relu(coarse))
        coarse, fine = F.relu(coarse + down), F.relu(fine + upsample(up, factor=4))
        fine = self.fine5(fine)
        context = self.context(self.coarse5(coarse))
        fused = fine + upsample(context, size=(fine.shape[2], fine.shape[3]))
        return NetworkOutput(semantic_logits=self.semantic_head(self.refine(fused)))


class Bottleneck(nn.Module):
    """1x1, 3x3, 1x1 to twice the channels around a shortcut, without the last ReLU."""

    def __init__(self, in_channels: int, channels: int, *, stride: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            ConvBNReLU(in_channels, channels, kernel=1),
            ConvBNReLU(channels, channels, stride=stride),
            conv_bn(channels, 2 * channels, kernel=1),
        )
        self.shortcut = shortcut(in_channels, 2 * channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, 2 C', ceil(H / stride), ceil(W / stride))."""
        out: Tensor = self.layers(x) + self.shortcut(x)
        return out


class PyramidContext(nn.Module):
    """The paper's DAPPM: means over larger and larger windows, each added to the next."""

    def __init__(self, in_channels: int, channels: int, out_channels: int) -> None:
        super().__init__()
        self.pools = nn.ModuleList(
            nn.AvgPool2d(2 * stride + 1, stride, stride) for stride in (2, 4, 8)
        )
        self.narrow = nn.ModuleList(_normed(in_channels, channels, 1) for _ in range(5))
        self.process = nn.ModuleList(_normed(channels, channels, 3) for _ in range(4))
        self.project = _normed(5 * channels, out_channels, 1)
        self.shortcut = _normed(in_channels, out_channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H, W)."""
        size = (x.shape[2], x.shape[3])
        means = [pool(x) for pool in self.pools] + [x.mean(dim=(2, 3), keepdim=True)]
        first, *others = self.narrow
        scales = [first(x)]
        for mean, narrow, process in zip(means, others, self.process, strict=True):
            scales.append(process(upsample(narrow(mean), size=size) + scales[-1]))
        out: Tensor = self.project(torch.cat(scales, dim=1)) + self.shortcut(x)
        return out


def _basic_stage(in_channels: int, out_channels: int, *, stride: int = 1) -> nn.Sequential:
    """Return two basic blocks with a ReLU between them."""
    return nn.Sequential(
        BasicBlock(in_channels, out_channels, stride=stride),
        nn.ReLU(),
        BasicBlock(out_channels, out_channels),
    )


def _normed(in_channels: int, out_channels: int, kernel: int) -> nn.Sequential:
    """Batch normalisation and ReLU in front of a convolution."""
    conv = nn.Conv2d(in_channels, out_channels, kernel, padding=kernel // 2, bias=False)
    return nn.Sequential(nn.BatchNorm2d(in_channels), nn.ReLU(), conv)
