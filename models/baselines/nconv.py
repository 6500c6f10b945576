"""NConv-CNN: depth completion from the LiDAR alone, with 480 parameters.

Paper: Eldesokey, Felsberg, Khan, "Propagating Confidences through CNNs for Sparse Data Regression",
BMVC 2018, section 3 and Figure 2.
"""

from math import sqrt

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.baselines.max_unpooling import max_mask, windows
from models.blocks import pad_to_multiple
from models.network import Network, NetworkConfig, NetworkOutput

_CHANNELS = 2
# How often the grid is halved; the layers between are the same at every size.
_LEVELS = 3
# A confidence below this value counts as 0; the value is above any rounding error in an empty
# window.
_NO_CONFIDENCE = 1e-6


class NConv(Network):
    """A pyramid of normalised convolutions, which propagate data and its confidence."""

    heads = ("depth",)
    stride = 2**_LEVELS

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.start = NormalisedConv(1, _CHANNELS, kernel=5)
        self.spread = NormalisedConv(_CHANNELS, _CHANNELS, kernel=5)
        self.spread_on = NormalisedConv(_CHANNELS, _CHANNELS, kernel=5)
        self.merge = nn.ModuleList(
            NormalisedConv(2 * _CHANNELS, _CHANNELS, kernel=3) for _ in range(_LEVELS)
        )
        self.depth_head = NormalisedConv(_CHANNELS, 1, kernel=1)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict at the padded image's size, see `Network.predict_coarse`."""
        depth, measured = self.normalise_depth(sparse_depth)
        x = pad_to_multiple(depth, self.stride)
        confidence = pad_to_multiple(measured.to(depth.dtype), self.stride)
        x, confidence = self.spread_on(*self.spread(*self.start(x, confidence)))
        levels = [(x, confidence)]
        for level in range(_LEVELS):
            x, confidence = self.spread(*_pool(x, confidence))
            if level == 0:  # the paper's figure has two layers at half size
                x, confidence = self.spread_on(x, confidence)
            levels.append((x, confidence))
        for merge, (fine, fine_confidence) in zip(self.merge, levels[-2::-1], strict=True):
            joined = torch.cat((fine, _double(x)), dim=1)
            x, confidence = merge(joined, torch.cat((fine_confidence, _double(confidence)), dim=1))
        answer, _ = self.depth_head(x, confidence)
        # The output is linear; it is clamped to the range in evaluation only.
        return NetworkOutput(depths=(answer if self.training else answer.clamp(0, 1),))


class NormalisedConv(nn.Module):
    """A convolution weighted by confidence, with weights that are never negative.

    Shapes: x (N, C, H, W), confidence (N, C, H, W) in 0..1; returns both, (N, C', H, W). The
    returned confidence is the confidence of the inputs, averaged by the weights.
    """

    def __init__(self, in_channels: int, out_channels: int, *, kernel: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(out_channels, in_channels, kernel, kernel))
        self.bias = nn.Parameter(torch.zeros(out_channels, 1, 1))
        nn.init.normal_(self.weight, 2.0, sqrt(2 / (kernel**2 * out_channels)))

    def forward(self, x: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
        """Return the weighted means plus bias, and the confidence in them."""
        weight = F.softplus(self.weight, beta=10)
        padding = weight.shape[-1] // 2
        support = F.conv2d(confidence, weight, padding=padding)
        sums = F.conv2d(x * confidence, weight, padding=padding)
        total = weight.sum(dim=(1, 2, 3)).view(-1, 1, 1)
        return sums / support.clamp(min=_NO_CONFIDENCE) + self.bias, support / total


def _pool(x: Tensor, confidence: Tensor) -> tuple[Tensor, Tensor]:
    """Keep the most confident value of each 2x2 window; its confidence counts for a quarter."""
    chosen = torch.where(max_mask(confidence), windows(x), 0.0).sum(dim=2)
    return chosen, F.max_pool2d(confidence, 2) / 4


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
