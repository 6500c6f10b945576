"""EfficientNet-Lite0's trunk (Tan and Le 2019; Liu 2020): ReLU6 and no squeeze-excitation.

It replaces the paper's encoder (section 2.1.1, `ssdnet.PlainEncoder`), which begins with 64
channels at full size and takes 62 times as many multiplications as that of `ssdnet-lite`. It was
designed for 8-bit integers. Weights trained on ImageNet fit it by name, see
`training.weights.imagenet_weights`; they need RGB normalised by `RGB_MEAN` and `RGB_STD`.
"""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional as F

# Mean and standard deviation of RGB in 0..255.
RGB_MEAN, RGB_STD = 127.0, 128.0
# Channels of the features, by their stride.
CHANNELS = {2: 16, 4: 24, 8: 40, 16: 112, 32: 320}
# Kernel, stride and channels of the blocks, up to each of these strides.
_STAGES = (
    ((3, 1, 16),),
    ((3, 2, 24), (3, 1, 24)),
    ((5, 2, 40), (5, 1, 40)),
    ((3, 2, 80), *((3, 1, 80),) * 2, *((5, 1, 112),) * 3),
    ((5, 2, 192), *((5, 1, 192),) * 3, (3, 1, 320)),
)
# Channels of the stem, then the inner channels of each block after the first: six times the
# channels of its input.
WIDTHS = (32, 96, *[144] * 2, *[240] * 2, *[480] * 3, *[672] * 3, *[1152] * 4)


class SameConv(nn.Conv2d):
    """Convolution without a bias, with the zero padding of TensorFlow's SAME at even sizes.

    With a stride of 2 this is one row and column more at the bottom and right than at the top and
    left. The padding is constant, so that an exporter makes it part of the convolution.
    """

    def __init__(
        self, in_channels: int, out_channels: int, kernel: int, stride: int = 1, groups: int = 1
    ) -> None:
        padding = kernel // 2 if stride == 1 else 0
        super().__init__(
            in_channels, out_channels, kernel, stride, padding, groups=groups, bias=False
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H / stride, W / stride)."""
        if self.stride[0] == 2:
            after = self.kernel_size[0] // 2
            x = F.pad(x, (after - 1, after, after - 1, after))
        return super().forward(x)


def _normalised(conv: SameConv) -> nn.Sequential:
    # TensorFlow's decay of 0.99 is PyTorch's momentum of 0.01.
    return nn.Sequential(conv, nn.BatchNorm2d(conv.out_channels, eps=1e-3, momentum=0.01))


class InvertedResidual(nn.Module):
    """Expansion, depthwise convolution, linear projection (Sandler et al. 2018)."""

    def __init__(
        self,
        in_channels: int,
        width: int,
        out_channels: int,
        kernel: int,
        stride: int,
        *,
        expand: bool,
    ) -> None:
        super().__init__()
        self.expand = _normalised(SameConv(in_channels, width, 1)) if expand else None
        self.depthwise = _normalised(SameConv(width, width, kernel, stride, groups=width))
        self.project = _normalised(SameConv(width, out_channels, 1))
        # The first block has no residual, whatever the pruned width of the stem.
        self.residual = expand and stride == 1 and in_channels == out_channels

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H / stride, W / stride)."""
        wide = x if self.expand is None else F.relu6(self.expand(x))
        out: Tensor = self.project(F.relu6(self.depthwise(wide)))
        return x + out if self.residual else out


class FusedBlock(nn.Module):
    """Dense convolution with a stride of 2, linear projection (EfficientNetV2, Tan and Le 2021).

    On a fine grid it is faster than `InvertedResidual`, whose wide maps take memory, not work.
    """

    def __init__(self, in_channels: int, width: int, out_channels: int) -> None:
        super().__init__()
        self.wide = _normalised(SameConv(in_channels, width, 3, 2))
        self.project = _normalised(SameConv(width, out_channels, 1))

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> (N, C', H / 2, W / 2)."""
        out: Tensor = self.project(F.relu6(self.wide(x)))
        return out


class EfficientNetLite(nn.Module):
    """Features at strides 2, 4, 8, 16 and 32, with `CHANNELS`, in two parts.

    Between the parts a network may add to the features at stride 4.

    Args:
        widths: channels of the stem and within each block, as pruning left them.
        fused_start: whether the stem alone makes the features at stride 2, and a `FusedBlock` the
            first ones at stride 4. Weights trained on ImageNet do not fit these layers.

    Raises:
        ValueError: unless there is a positive width for each block, and that of a stem without a
            block behind it is `CHANNELS[2]`.
    """

    def __init__(self, widths: Sequence[int] = WIDTHS, *, fused_start: bool = False) -> None:
        super().__init__()
        if len(widths) != len(WIDTHS) or min(widths) < 1:
            raise ValueError(f"expected {len(WIDTHS)} positive widths, got {tuple(widths)}")
        if fused_start and widths[0] != CHANNELS[2]:
            raise ValueError(f"a fused start has a stem of {CHANNELS[2]} channels, got {widths[0]}")
        self.stem = nn.Sequential(_normalised(SameConv(3, widths[0], 3, 2)), nn.ReLU6())
        channels, following = widths[0], iter(widths)
        stages: list[nn.Sequential] = []
        for table in _STAGES:
            blocks = []
            for kernel, stride, out_channels in table:
                block = InvertedResidual(
                    channels, next(following), out_channels, kernel, stride, expand=bool(stages)
                )
                blocks.append(block)
                channels = out_channels
            stages.append(nn.Sequential(*blocks))
        if fused_start:
            first = FusedBlock(CHANNELS[2], widths[1], CHANNELS[4])
            stages[:2] = nn.Sequential(), nn.Sequential(first, *list(stages[1])[1:])
        self.stride2, self.stride4, self.stride8, self.stride16, self.stride32 = stages

    def early(self, rgb: Tensor) -> tuple[Tensor, Tensor]:
        """Return the features at strides 2 and 4 of normalised RGB (N, 3, H, W).

        H and W are multiples of 32, as `blocks.pad_to_multiple` makes them.
        """
        at_2 = self.stride2(self.stem(rgb))
        return at_2, self.stride4(at_2)

    def late(self, at_4: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the features at strides 8, 16 and 32, computed from those at stride 4."""
        at_8 = self.stride8(at_4)
        at_16 = self.stride16(at_8)
        return at_8, at_16, self.stride32(at_16)
