"""Residual blocks of DDRNet and PIDNet, which end without ReLU."""

from torch import Tensor, nn

from models.blocks import ConvBNReLU


class BasicBlock(nn.Module):
    """Two 3x3 convolutions around a shortcut (He et al. 2016), without the last ReLU."""

    def __init__(self, in_channels: int, out_channels: int, *, stride: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            ConvBNReLU(in_channels, out_channels, stride=stride),
            conv_bn(out_channels, out_channels),
        )
        self.shortcut = _shortcut(in_channels, out_channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', ceil(H / stride), ceil(W / stride))."""
        out: Tensor = self.layers(x) + self.shortcut(x)
        return out


class Bottleneck(nn.Module):
    """1x1, 3x3, 1x1 to twice the channels around a shortcut, without the last ReLU."""

    def __init__(self, in_channels: int, channels: int, *, stride: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            ConvBNReLU(in_channels, channels, kernel=1),
            ConvBNReLU(channels, channels, stride=stride),
            conv_bn(channels, 2 * channels, kernel=1),
        )
        self.shortcut = _shortcut(in_channels, 2 * channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, 2 C', ceil(H / stride), ceil(W / stride))."""
        out: Tensor = self.layers(x) + self.shortcut(x)
        return out


def basic_stage(
    in_channels: int, out_channels: int, *, count: int = 2, stride: int = 1
) -> nn.Sequential:
    """So many basic blocks with a ReLU between."""
    layers: list[nn.Module] = [BasicBlock(in_channels, out_channels, stride=stride)]
    for _ in range(count - 1):
        layers += [nn.ReLU(), BasicBlock(out_channels, out_channels)]
    return nn.Sequential(*layers)


def conv_bn(
    in_channels: int, out_channels: int, *, kernel: int = 3, stride: int = 1
) -> nn.Sequential:
    """A convolution and batch normalisation, without ReLU."""
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(out_channels),
    )


def normed(conv: nn.Conv2d) -> nn.Sequential:
    """Batch normalisation and ReLU in front of a convolution."""
    return nn.Sequential(nn.BatchNorm2d(conv.in_channels), nn.ReLU(), conv)


def _shortcut(in_channels: int, out_channels: int, stride: int) -> nn.Module:
    if stride == 1 and in_channels == out_channels:
        return nn.Identity()
    return conv_bn(in_channels, out_channels, kernel=1, stride=stride)
