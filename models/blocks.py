"""Building blocks of the networks; `BaConv` is Eq. 1 of the paper, the others are common ones."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models import fast_cpu
from models.fast_cpu import fast_on_cpu


class ConvBNReLU(nn.Sequential):
    """Convolution, batch normalisation, ReLU: (N, C, H, W) -> (N, C', H', W')."""

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        *,
        kernel: int = 3,
        stride: int = 1,
        dilation: int = 1,
        groups: int = 1,
    ) -> None:
        shape, padding = (in_channels, out_channels, kernel, stride), dilation * (kernel // 2)
        super().__init__(
            nn.Conv2d(*shape, padding, dilation, groups, bias=False),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(inplace=True),
        )


def separable_conv(in_channels: int, out_channels: int) -> nn.Sequential:
    """A 3x3 kernel for each channel, then a 1x1 convolution (Chollet 2017), without bias."""
    return nn.Sequential(
        nn.Conv2d(in_channels, in_channels, 3, padding=1, groups=in_channels, bias=False),
        nn.Conv2d(in_channels, out_channels, 1, bias=False),
    )


class BaConv(nn.Module):
    """Boundary-aware convolution, Eq. 1: y(p) = sum_n w(p_n) x(p_n) (1 - B(p_n)).

    Gating the input before an ordinary convolution gives the same sum, so an exported graph needs
    no custom operator, only `Mul` and `Conv`.

    Shapes: x (N, C, H, W), boundary (N, 1, H, W) in 0..1, None means 0; returns (N, C', H, W).
    There is no bias. In a separable one, w is a 3x3 kernel for each channel and then a 1x1
    convolution.
    """

    def __init__(self, in_channels: int, out_channels: int, *, separable: bool = False) -> None:
        super().__init__()
        # Made in both cases: from one seed, the layers after it then have the same weights.
        dense = nn.Conv2d(in_channels, out_channels, 3, padding=1, bias=False)
        self.conv = separable_conv(in_channels, out_channels) if separable else dense

    def forward(self, x: Tensor, boundary: Tensor | None) -> Tensor:
        """Convolve x * (1 - boundary)."""
        out: Tensor = self.conv(x if boundary is None else gate(x, boundary))
        return out


@fast_on_cpu(fast_cpu.gate)
def gate(x: Tensor, boundary: Tensor) -> Tensor:
    """Return x * (1 - boundary)."""
    return x * (1.0 - boundary)


def conv_bn(
    in_channels: int, out_channels: int, *, kernel: int = 3, stride: int = 1
) -> nn.Sequential:
    """A convolution and batch normalisation, without ReLU."""
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(out_channels),
    )


def up_conv_bn_relu(in_channels: int, out_channels: int, *, bias: bool = True) -> nn.Sequential:
    """A transposed 3x3 convolution to twice the size, batch normalisation, ReLU."""
    return nn.Sequential(
        nn.ConvTranspose2d(in_channels, out_channels, 3, 2, 1, output_padding=1, bias=bias),
        nn.BatchNorm2d(out_channels),
        nn.ReLU(inplace=True),
    )


def shortcut(in_channels: int, out_channels: int, stride: int) -> nn.Module:
    """The identity, or a 1x1 convolution where the shape changes."""
    if stride == 1 and in_channels == out_channels:
        return nn.Identity()
    return conv_bn(in_channels, out_channels, kernel=1, stride=stride)


class GlobalContext(nn.Module):
    """Adds the projected global mean of the features to them: (N, C, H, W) -> same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        # No batch normalisation: one value per channel and image is too few to normalise over.
        self.project = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return relu(x + W mean(x))."""
        return F.relu(x + self.project(x.mean(dim=(2, 3), keepdim=True)))


def upsample(x: Tensor, *, factor: int = 2, size: tuple[int, int] | None = None) -> Tensor:
    """Bilinear upsampling with half-pixel centres, by an integer factor or to (height, width)."""
    if size is not None:
        return F.interpolate(x, size=size, mode="bilinear", align_corners=False)
    return x if factor == 1 else enlarge(x, factor)


@fast_on_cpu(fast_cpu.enlarge)
def enlarge(x: Tensor, factor: int) -> Tensor:
    return F.interpolate(x, scale_factor=float(factor), mode="bilinear", align_corners=False)


def upsample_nearest(x: Tensor, factor: int) -> Tensor:
    """Repeat each pixel of (N, C, h, w) `factor` times along both sides; a power of two.

    It is doubled again and again, because ONNX Runtime doubles five times as fast.
    """
    for _ in range(factor.bit_length() - 1):
        x = F.interpolate(x, scale_factor=2.0, mode="nearest")
    return x


def hard_sigmoid(x: Tensor, slope: float, offset: float) -> Tensor:
    """`slope * x + offset` limited to 0..1: in an exported graph one HardSigmoid, not three."""
    if torch.compiler.is_exporting():
        return torch.onnx.ops.symbolic(
            "HardSigmoid", [x], {"alpha": slope, "beta": offset}, dtype=x.dtype, shape=x.shape
        )
    return (slope * x + offset).clamp(0.0, 1.0)


def pad_to_multiple(x: Tensor, multiple: int) -> Tensor:
    """Pad (N, C, H, W) with zeros at the bottom and right to a multiple of `multiple`."""
    return F.pad(x, (0, -x.shape[3] % multiple, 0, -x.shape[2] % multiple))


def extend_to_multiple(x: Tensor, multiple: int) -> Tensor:
    """Repeat the last row and column of (N, C, H, W) up to a multiple of `multiple`.

    Use it for maps that are pooled next: ONNX Runtime fuses zero padding into a pooling, and then
    refuses a model whose padding is as wide as the window.
    """
    return F.pad(x, (0, -x.shape[3] % multiple, 0, -x.shape[2] % multiple), mode="replicate")


def adaptive_mean(x: Tensor, cells: int) -> Tensor:
    """Mean over a grid of cells x cells: (N, C, H, W) -> (N, C, cells, cells).

    It is adaptive average pooling as two matrix products, which ONNX can express for any H and W.
    """
    rows, columns = (_cell_means(x, x.shape[axis], cells) for axis in (2, 3))
    return rows @ x @ columns.transpose(0, 1)


def _cell_means(x: Tensor, length: int, cells: int) -> Tensor:
    """Weights (cells, length) of the means.

    Cell i goes from floor(i * length / cells) to ceil((i + 1) * length / cells).
    """
    place = torch.arange(length, device=x.device)
    cell = torch.arange(cells, device=x.device)[:, None]
    inside = (place >= cell * length // cells) & (place < -(-(cell + 1) * length // cells))
    weights = inside.to(x.dtype)
    return weights / weights.sum(dim=1, keepdim=True)
