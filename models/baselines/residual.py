"""What DDRNet and PIDNet share: residual blocks without the last ReLU, and pyramid pooling."""

from torch import Tensor, nn

from models.blocks import ConvBNReLU, conv_bn, shortcut, upsample


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


class PoolingPyramid(nn.Module):
    """Means over larger and larger windows, each upsampled to the features' size.

    It is the base of DDRNet's and PIDNet's context modules, which differ in `process`.
    """

    def __init__(
        self, in_channels: int, channels: int, out_channels: int, process: nn.Module
    ) -> None:
        super().__init__()
        self.pools = nn.ModuleList(
            nn.AvgPool2d(2 * stride + 1, stride, stride) for stride in (2, 4, 8)
        )
        self.narrow = nn.ModuleList(
            normed(nn.Conv2d(in_channels, channels, 1, bias=False)) for _ in range(5)
        )
        self.process = process
        self.project = normed(nn.Conv2d(5 * channels, out_channels, 1, bias=False))
        self.shortcut = normed(nn.Conv2d(in_channels, out_channels, 1, bias=False))

    def pool(self, x: Tensor) -> list[Tensor]:
        """(N, C, H, W) -> the features themselves and four means, each (N, channels, H, W)."""
        size = (x.shape[2], x.shape[3])
        means = [pool(x) for pool in self.pools] + [x.mean(dim=(2, 3), keepdim=True)]
        first, *others = self.narrow
        pairs = zip(others, means, strict=True)
        return [first(x), *(upsample(narrow(mean), size=size) for narrow, mean in pairs)]


def basic_stage(
    in_channels: int, out_channels: int, *, count: int = 2, stride: int = 1
) -> nn.Sequential:
    """Return a sequence of basic blocks with a ReLU between them."""
    layers: list[nn.Module] = [BasicBlock(in_channels, out_channels, stride=stride)]
    for _ in range(count - 1):
        layers += [nn.ReLU(), BasicBlock(out_channels, out_channels)]
    return nn.Sequential(*layers)


def normed(conv: nn.Conv2d) -> nn.Sequential:
    """Batch normalisation and ReLU in front of a convolution."""
    return nn.Sequential(nn.BatchNorm2d(conv.in_channels), nn.ReLU(), conv)


def refinement(in_channels: int, channels: int) -> nn.Sequential:
    """The 3x3 convolution in front of the classifier, normalised before and after."""
    return nn.Sequential(nn.BatchNorm2d(in_channels), nn.ReLU(), *ConvBNReLU(in_channels, channels))
