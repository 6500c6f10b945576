"""SSDNet: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder, a boundary decoder and two task decoders of boundary-aware convolutions.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, pad_to_multiple
from models.boundary_decoder import BoundaryDecoder
from models.encoder_decoder import EncoderDecoderConfig
from models.network import Network, NetworkOutput, initialise
from models.task_decoder import TaskDecoder


@dataclass(frozen=True)
class SSDNetConfig(EncoderDecoderConfig):
    """The configuration of an `SSDNet`: heads, inputs, channels.

    The defaults are the paper's full network with the channel list that reproduces its printed
    parameters and multiply-accumulates.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet"
    encoder_channels: tuple[int, ...] = (64, 128, 256, 512, 512)
    encoder_blocks: tuple[int, ...] = (2, 2, 3, 3, 3)
    decoder_channels: tuple[int, ...] = (512, 192, 96, 64, 16)
    use_rgb: bool = True
    use_sparse_depth: bool = True
    #: Factor on the normalised sparse depth at the input. At 5 % of the pixels its mean is a
    #: twentieth of that of the normalised colours, and the network learns to use it late.
    sparse_depth_gain: float = 1.0

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        super().__post_init__()
        if not (self.use_rgb or self.use_sparse_depth):
            raise ValueError("a network needs rgb, sparse depth or both as input")
        if not self.sparse_depth_gain > 0:
            raise ValueError(f"sparse_depth_gain must be positive, got {self.sparse_depth_gain}")

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        return len(self.encoder_channels)

    @property
    def output_stride(self) -> int:
        """Ratio of the image to the finest grid."""
        return int(2 ** len(self.stem_channels))


class SSDNet(Network):
    """The paper's network, with all or some of its heads and inputs."""

    config: SSDNetConfig

    def __init__(self, config: SSDNetConfig) -> None:
        super().__init__(config)
        in_channels = 3 * config.use_rgb + config.use_sparse_depth
        stem: list[nn.Module] = []
        for channels in config.stem_channels:
            stem.append(ConvBNReLU(in_channels, channels, stride=2))
            in_channels = channels
        self.stem = nn.Sequential(*stem)
        self.encoder = PlainEncoder(config, in_channels)
        skips = config.encoder_channels
        self.boundary_decoder = BoundaryDecoder(
            skips, config.boundary_channels, padded=bool(config.stem_channels)
        )
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config.decoder_channels, skips, skips[-1], "concat")
            self.semantic_head = nn.Conv2d(config.decoder_channels[-1], config.num_classes, 1)
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config.decoder_channels, skips, skips[-1], "concat")
            self.depth_heads = nn.ModuleList(
                nn.Conv2d(channels, 1, 1) for channels in reversed(config.decoder_channels)
            )
        self.apply(initialise)

    @property
    def heads(self) -> tuple[str, ...]:
        """The network's heads; a boundary always."""
        config = self.config
        present = {"semantic": config.semantic_head, "depth": config.depth_head, "boundary": True}
        return tuple(head for head, there in present.items() if there)

    @property
    def stride(self) -> int:
        """Ratio of the image to the coarsest grid."""
        return int(self.config.output_stride * 2**self.config.num_skips)

    @property
    def semantic_stride(self) -> int:
        """Ratio of the image to the grid of the semantic logits."""
        return self.config.output_stride

    @property
    def depth_stride(self) -> int:
        """Ratio of the image to the grid of the finest depth."""
        return self.config.output_stride

    @property
    def boundary_stride(self) -> int:
        """Ratio of the image to the grid of the boundary."""
        return self.config.output_stride

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids, see `Network.predict_coarse`.

        A network with a strided stem pads the image to a multiple of its stride, others do not.
        """
        config = self.config
        inputs = [self.normalise_rgb(rgb)] if config.use_rgb else []
        if config.use_sparse_depth:
            inputs.append(self.normalise_depth(sparse_depth)[0] * config.sparse_depth_gain)
        if config.stem_channels:
            inputs = [pad_to_multiple(x, self.stride) for x in inputs]
        skips, bottom = self.encoder(self.stem(torch.cat(inputs, dim=1)))
        boundary_logits, sides = self.boundary_decoder(skips)
        gates = [torch.sigmoid(side) if config.boundary_gating else None for side in sides]
        logits = depths = None
        if config.semantic_head:
            logits = self.semantic_head(self.semantic_decoder(bottom, skips, gates)[0])
        if config.depth_head:
            features = self.depth_decoder(bottom, skips, gates)
            pairs = zip(self.depth_heads, features, strict=True)
            depths = tuple(torch.sigmoid(head(feature)) for head, feature in pairs)
        return NetworkOutput(logits, depths, boundary_logits, tuple(sides))


class PlainEncoder(nn.Module):
    """VGG's cascaded 3x3 convolutions; every stage is a skip, 2x2 max-pool after each.

    Paper, section 2.1.1 and Figure 2a. Pooling rounds up, so 125 x 414 becomes 63x207, 32x104,
    16x52, 8x26 and 4x13, the sizes that reproduce the paper's multiply-accumulates.
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

    def forward(self, x: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return the skips S_1 (finest) ... S_n and the pooled bottom."""
        skips = []
        for stage in self.stages:
            x = stage(x)
            skips.append(x)
            x = F.max_pool2d(x, 2, ceil_mode=True)
        return skips, x


def _with_ablations(config: SSDNetConfig) -> tuple[SSDNetConfig, ...]:
    """Return a network and the rows of the paper's ablation; SSDNet_ind differs only in losses."""
    depth_alone: dict[str, Any] = {"semantic_head": False, "classes": ()}
    variants: dict[str, dict[str, Any]] = {
        "sem": {"depth_head": False},
        "dep": depth_alone,
        "dep-d": {**depth_alone, "use_rgb": False},
        "dep-rgb": {**depth_alone, "use_sparse_depth": False},
    }
    return config, *(
        replace(config, name=f"{config.name}-{suffix}", **changes)
        for suffix, changes in variants.items()
    )


#: The paper's network and its ablations, and the same structure at a fortieth of the parameters,
#: for experiments on a CPU: a strided stem instead of the first stage at full size, and narrower.
SSDNETS = (
    *_with_ablations(SSDNetConfig()),
    *_with_ablations(
        SSDNetConfig(
            name="ssdnet-small",
            stem_channels=(16,),
            encoder_channels=(32, 48, 64, 96),
            encoder_blocks=(1, 2, 2, 2),
            decoder_channels=(64, 48, 32, 16),
        )
    ),
)
