"""Encoders of `SSDNetLite`: each in two parts, between which the network adds what returns show."""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from models.blocks import ConvBNReLU, ResidualBlock
from models.efficientnet_lite import CHANNELS, WIDTHS, EfficientNetLite
from models.ssdnet_config import SSDNetLiteConfig


class LiteEncoder(nn.Module):
    """Base of the encoders of `SSDNetLite`. All sizes are multiples of the coarsest stride.

    Attributes:
        early_channels: of the features of `early`, at strides 2 and 4.
        late_channels: of the features of `late`, at strides 4, 8, ...
        linear: whether the features have no activation; their magnitudes then differ by stride.
    """

    early_channels: tuple[int, int]
    late_channels: tuple[int, ...]
    linear = False

    def early(self, rgb: Tensor, depth: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Return the features at strides 2 and 4 of normalised inputs, each (N, C, H, W)."""
        raise NotImplementedError

    def late(self, at_4: Tensor) -> list[Tensor]:
        """Return the skips at strides 4, 8, ..., and the bottom, of the features at stride 4."""
        raise NotImplementedError


class ResidualEncoder(LiteEncoder):
    """A stem of two strided convolutions, then residual stages, strided between them."""

    def __init__(self, config: SSDNetLiteConfig) -> None:
        super().__init__()
        fine, coarse = config.stem_channels
        self.stem = nn.Sequential(
            ConvBNReLU(5, fine, stride=2),  # colours, depth, its mask
            ConvBNReLU(fine, coarse, stride=2),
        )
        stages = []
        in_channels = coarse
        for index, (channels, blocks) in enumerate(
            zip(config.encoder_channels, config.encoder_blocks, strict=True)
        ):
            layers = [ResidualBlock(in_channels, channels, stride=1 if index == 0 else 2)]
            layers += [ResidualBlock(channels, channels) for _ in range(blocks - 1)]
            stages.append(nn.Sequential(*layers))
            in_channels = channels
        self.stages = nn.ModuleList(stages)
        self.early_channels = fine, coarse
        self.late_channels = config.encoder_channels

    def early(self, rgb: Tensor, depth: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """See `LiteEncoder`."""
        at_2 = self.stem[0](torch.cat([rgb, depth, mask], dim=1))
        return at_2, self.stem[1](at_2)

    def late(self, at_4: Tensor) -> list[Tensor]:
        """See `LiteEncoder`."""
        features = []
        x = at_4
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features


class EfficientNetEncoder(LiteEncoder):
    """EfficientNet-Lite0's trunk, which reads the colours alone."""

    linear = True

    def __init__(self, config: SSDNetLiteConfig) -> None:
        super().__init__()
        self.trunk = EfficientNetLite(config.encoder_widths or WIDTHS)
        self.early_channels = CHANNELS[2], CHANNELS[4]
        self.late_channels = tuple(CHANNELS[stride] for stride in (4, 8, 16, 32))

    def early(self, rgb: Tensor, depth: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """See `LiteEncoder`."""
        return self.trunk.early(rgb)

    def late(self, at_4: Tensor) -> list[Tensor]:
        """See `LiteEncoder`."""
        return [at_4, *self.trunk.late(at_4)]


#: `SSDNetLiteConfig.encoder` -> the class, which takes the configuration.
ENCODERS: dict[str, Callable[[SSDNetLiteConfig], LiteEncoder]] = {
    "residual": ResidualEncoder,
    "efficientnet-lite0": EfficientNetEncoder,
}
