"""The residual block of DDRNet and of Sparse-to-dense."""

from torch import Tensor, nn

from models.blocks import ConvBNReLU, conv_bn, shortcut


class BasicBlock(nn.Module):
    """Two 3x3 convolutions around a shortcut (He et al. 2016), without the last ReLU."""

    def __init__(self, in_channels: int, out_channels: int, *, stride: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            ConvBNReLU(in_channels, out_channels, stride=stride),
            conv_bn(out_channels, out_channels),
        )
        self.shortcut = shortcut(in_channels, out_channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', ceil(H / stride), ceil(W / stride))."""
        out: Tensor = self.layers(x) + self.shortcut(x)
        return out
