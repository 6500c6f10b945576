"""DDRNet-23-slim: semantic segmentation from RGB alone.

Paper: Hong, Pan, Sun, Jia, "Deep Dual-resolution Networks for Real-time and Accurate Semantic
Segmentation of Road Scenes", 2021, Table 1 and Figure 4. The extra head on the fine branch, which
the authors add for training, is left out.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.residual import Bottleneck, PoolingPyramid, basic_stage, normed, refinement
from models.blocks import ConvBNReLU, conv_bn, pad_to_multiple, upsample
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
        self.stage1 = basic_stage(c, c)
        self.stage2 = basic_stage(c, 2 * c, stride=2)
        self.coarse3 = basic_stage(2 * c, 4 * c, stride=2)
        self.coarse4 = basic_stage(4 * c, 8 * c, stride=2)
        self.coarse5 = Bottleneck(8 * c, 8 * c, stride=2)
        self.fine3 = basic_stage(2 * c, _FINE)
        self.fine4 = basic_stage(_FINE, _FINE)
        self.fine5 = Bottleneck(_FINE, _FINE)
        self.up3 = conv_bn(4 * c, _FINE, kernel=1)
        self.up4 = conv_bn(8 * c, _FINE, kernel=1)
        self.down3 = conv_bn(_FINE, 4 * c, stride=2)
        self.down4 = nn.Sequential(
            ConvBNReLU(_FINE, 4 * c, stride=2), conv_bn(4 * c, 8 * c, stride=2)
        )
        self.context = PyramidContext(16 * c, _CONTEXT, 2 * _FINE)
        self.refine = refinement(2 * _FINE, _HEAD)
        self.semantic_head = nn.Conv2d(_HEAD, config.num_classes, 1)
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


class PyramidContext(PoolingPyramid):
    """The paper's DAPPM: each mean is added to the next."""

    process: nn.ModuleList

    def __init__(self, in_channels: int, channels: int, out_channels: int) -> None:
        process = nn.ModuleList(
            normed(nn.Conv2d(channels, channels, 3, padding=1, bias=False)) for _ in range(4)
        )
        super().__init__(in_channels, channels, out_channels, process)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H, W)."""
        finest, *means = self.pool(x)
        scales = [finest]
        for mean, process in zip(means, self.process, strict=True):
            scales.append(process(mean + scales[-1]))
        out: Tensor = self.project(torch.cat(scales, dim=1)) + self.shortcut(x)
        return out
