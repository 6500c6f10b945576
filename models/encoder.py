"""The shared encoder (paper, section 2.1.1 and Figure 2a): plain or residual."""

from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, GlobalContext, ResidualBlock
from models.ssdnet_config import SSDNetConfig


class PlainEncoder(nn.Module):
    """VGG's cascaded 3x3 convolutions; every stage is a skip, 2x2 max-pool after each.

    Pooling rounds up, so 125 x 414 becomes 63x207, 32x104, 16x52, 8x26 and 4x13, the sizes that
    reproduce the paper's multiply-accumulates.
    """

    def __init__(self, config: SSDNetConfig, in_channels: int) -> None:
        super().__init__()
        stages = []
        for channels, blocks in zip(config.encoder_channels, config.encoder_blocks, strict=True):
            convs = [ConvBNReLU(in_channels, channels)]
            convs += [ConvBNReLU(channels, channels) for _ in range(blocks - 1)]
            stages.append(nn.Sequential(*convs))
            in_channels = channels
        self.stages = nn.ModuleList(stages)
        self.skip_channels = config.encoder_channels
        self.bottom_channels = in_channels

    def forward(self, x: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the skips S_1 (finest) ... S_n and the pooled bottom."""
        skips = []
        for stage in self.stages:
            x = stage(x)
            skips.append(x)
            x = F.max_pool2d(x, 2, ceil_mode=True)
        return skips, x


class ResidualEncoder(nn.Module):
    """Residual stages, strided between them; the last is the bottom, the others are skips."""

    def __init__(self, config: SSDNetConfig, in_channels: int) -> None:
        super().__init__()
        stages = []
        for index, (channels, blocks) in enumerate(
            zip(config.encoder_channels, config.encoder_blocks, strict=True)
        ):
            layers: list[nn.Module] = [
                ResidualBlock(in_channels, channels, stride=1 if index == 0 else 2)
            ]
            layers += [ResidualBlock(channels, channels) for _ in range(blocks - 1)]
            stages.append(nn.Sequential(*layers))
            in_channels = channels
        self.stages = nn.ModuleList(stages)
        self.context = GlobalContext(in_channels) if config.global_context else nn.Identity()
        self.skip_channels = config.encoder_channels[:-1]
        self.bottom_channels = in_channels

    def forward(self, x: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the skips S_1 (finest) ... S_n and the bottom."""
        features = []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features[:-1], self.context(features[-1])


def build_encoder(config: SSDNetConfig, in_channels: int) -> PlainEncoder | ResidualEncoder:
    """Return the encoder that ``config.encoder_block`` names."""
    return (PlainEncoder if config.encoder_block == "plain" else ResidualEncoder)(
        config, in_channels
    )
