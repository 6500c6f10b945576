"""ESPNet: semantic segmentation from RGB alone.

Paper: Mehta, Rastegari, Caspi, Shapiro, Hajishirzi, "ESPNet: Efficient Spatial Pyramid of Dilated
Convolutions for Semantic Segmentation", ECCV 2018, Figures 1 and 4, with p = 2 and q = 8 blocks.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import extend_to_multiple
from models.network import Network, NetworkConfig, NetworkOutput, initialise

# Blocks at a quarter (the paper's p) and at an eighth (q) of the image.
_BLOCKS = (2, 8)
# Dilations of the parallel convolutions.
_DILATIONS = (1, 2, 4, 8, 16)


class ESPNet(Network):
    """Spatial pyramids of dilated convolutions, with the image fed in again at each size."""

    heads = ("semantic",)
    stride = 8

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        classes = config.num_scores
        self.level1 = nn.Sequential(nn.Conv2d(3, 16, 3, 2, 1, bias=False), *_finish(16))
        self.join1 = nn.Sequential(*_finish(16 + 3))
        self.down2 = SpatialPyramid(16 + 3, 64, stride=2)
        self.level2 = nn.Sequential(*(SpatialPyramid(64, 64) for _ in range(_BLOCKS[0])))
        self.join2 = nn.Sequential(*_finish(2 * 64 + 3))
        self.down3 = SpatialPyramid(2 * 64 + 3, 128, stride=2)
        self.level3 = nn.Sequential(*(SpatialPyramid(128, 128) for _ in range(_BLOCKS[1])))
        self.join3 = nn.Sequential(*_finish(2 * 128))
        # The decoder works on class scores throughout.
        self.score3 = nn.Sequential(
            nn.Conv2d(2 * 128, classes, 1, bias=False),
            nn.BatchNorm2d(classes),
            nn.ConvTranspose2d(classes, classes, 2, 2, bias=False),
        )
        self.score2 = nn.Conv2d(2 * 64 + 3, classes, 1, bias=False)
        self.merge2 = nn.Sequential(
            *_finish(2 * classes),
            SpatialPyramid(2 * classes, classes),
            nn.ConvTranspose2d(classes, classes, 2, 2, bias=False),
            *_finish(classes),
        )
        self.merge1 = nn.Sequential(
            nn.Conv2d(classes + 16 + 3, classes, 3, padding=1, bias=False), *_finish(classes)
        )
        self.semantic_head = nn.ConvTranspose2d(classes, classes, 2, 2)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict at the padded image's size, see `Network.predict_coarse`."""
        x = extend_to_multiple(self.normalise_rgb(rgb), self.stride)
        half = F.avg_pool2d(x, 3, 2, 1)
        quarter = F.avg_pool2d(half, 3, 2, 1)
        joined1 = self.join1(torch.cat((self.level1(x), half), dim=1))
        down2 = self.down2(joined1)
        joined2 = self.join2(torch.cat((self.level2(down2), down2, quarter), dim=1))
        down3 = self.down3(joined2)
        joined3 = self.join3(torch.cat((down3, self.level3(down3)), dim=1))
        scores = torch.cat((self.score2(joined2), self.score3(joined3)), dim=1)
        scores = self.merge1(torch.cat((self.merge2(scores), joined1), dim=1))
        return NetworkOutput(semantic_logits=self.semantic_head(scores))


class SpatialPyramid(nn.Module):
    """The paper's ESP: reduce, convolve at five dilations, sum from fine to coarse, concatenate.

    The input is added if it has the output's shape.
    """

    def __init__(self, in_channels: int, out_channels: int, *, stride: int = 1) -> None:
        super().__init__()
        dilations = _DILATIONS[:out_channels]  # of fewer channels than dilations, one for each
        narrow = out_channels // len(dilations)
        first = out_channels - (len(dilations) - 1) * narrow  # the remainder of the division
        kernel = 3 if stride > 1 else 1
        self.reduce = nn.Conv2d(in_channels, narrow, kernel, stride, kernel // 2, bias=False)
        self.transform = nn.ModuleList(
            nn.Conv2d(narrow, first if d == 1 else narrow, 3, 1, d, d, bias=False)
            for d in dilations
        )
        self.finish = nn.Sequential(*_finish(out_channels))
        self.adds = stride == 1 and in_channels == out_channels

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', ceil(H / stride), ceil(W / stride))."""
        reduced = self.reduce(x)
        parts = [transform(reduced) for transform in self.transform]
        for index in range(2, len(parts)):  # hierarchical feature fusion, against gridding
            parts[index] = parts[index] + parts[index - 1]
        joined = torch.cat(parts, dim=1)
        out: Tensor = self.finish(x + joined if self.adds else joined)
        return out


def _finish(channels: int) -> list[nn.Module]:
    return [nn.BatchNorm2d(channels), nn.PReLU(channels)]
