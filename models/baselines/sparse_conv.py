"""SparseConvNet: depth completion from the LiDAR alone.

Paper: Uhrig, Schneider, Schneider, Franke, Brox, Geiger, "Sparsity Invariant CNNs", 3DV 2017,
section 3 and Figure 2.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network import Network, NetworkConfig, NetworkOutput, initialise

_CHANNELS = 16
_KERNELS = (11, 7, 5, 3, 3)


class SparseConvNet(Network):
    """Sparse convolutions at full size, from 11x11 to 1x1."""

    heads = ("depth",)
    stride = 1

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        in_channels, layers = 1, []
        for kernel in _KERNELS:
            layers.append(SparseConv(in_channels, _CHANNELS, kernel=kernel))
            in_channels = _CHANNELS
        self.layers = nn.ModuleList(layers)
        self.depth_head = SparseConv(_CHANNELS, 1, kernel=1)
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict at full size, see `Network.predict_coarse`."""
        x, measured = self.normalise_depth(sparse_depth)
        mask = measured.to(x.dtype)
        for layer in self.layers:
            x, mask = layer(x, mask)
            x = torch.relu(x)
        depth, _ = self.depth_head(x, mask)
        # The output is linear; it is clamped to the range in evaluation only.
        return NetworkOutput(depths=(depth if self.training else depth.clamp(0, 1),))


class SparseConv(nn.Module):
    """A convolution over the measured pixels: sum divided by the share of them, plus bias.

    The paper divides by their count, which differs by a constant factor in the weights. With the
    share, weights of the usual size keep the magnitude of the features through six layers.

    Shapes: x (N, C, H, W), mask (N, 1, H, W), 0 or 1; returns (N, C', H, W) and the mask of
    windows that hold a measurement.
    """

    def __init__(self, in_channels: int, out_channels: int, *, kernel: int) -> None:
        super().__init__()
        self.kernel = kernel
        self.conv = nn.Conv2d(in_channels, out_channels, kernel, padding=kernel // 2, bias=False)
        self.bias = nn.Parameter(torch.zeros(out_channels, 1, 1))

    def forward(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Convolve and grow the mask."""
        share = F.avg_pool2d(mask, self.kernel, 1, self.kernel // 2)
        # An empty window is 0 divided by 1: exact, while the paper adds a small number.
        out = self.conv(x * mask) / share.clamp(min=1 / self.kernel**2) + self.bias
        return out, F.max_pool2d(mask, self.kernel, 1, self.kernel // 2)
