"""SSDNet as published: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder (section 2.1.1), a boundary decoder (2.1.2) and two task decoders of
boundary-aware convolutions (Eq. 1, section 2.1.3).
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, pad_to_multiple
from models.decoders import BoundaryDecoder, ConcatUpBlock, TaskDecoder
from models.network import (
    Network,
    NetworkConfig,
    NetworkOutput,
    check_counts,
    initialise,
    present_heads,
)

# Limits, far beyond any network in use.
MAX_STAGES = 8
MAX_BLOCKS = 100


@dataclass(frozen=True)
class SSDNetConfig(NetworkConfig):
    """The configuration of an `SSDNet`: heads, inputs, channels.

    The defaults are the paper's full network with the channel list that reproduces its printed
    parameters and multiply-accumulates.

    Attributes:
        stem_channels: channels of 3x3 stride-2 convolutions in front of the first stage; () starts
            at full size.
        encoder_channels: channels and blocks of each encoder stage, fine to coarse; each stage is a
            skip.
        decoder_channels: channels of the UpBlocks, coarse to fine: one for each skip.
        boundary_channels: channels of the side outputs of the boundary decoder.
        boundary_gating: gate the decoders by 1 - B (Eq. 1). If false, B = 0 and a BaConv is a plain
            convolution.
        sparse_depth_gain: factor on the normalised sparse depth at the input. At 5 % of the pixels
            its mean is a twentieth of that of the normalised colours, and the network learns to use
            it late.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet"
    semantic_head: bool = True
    depth_head: bool = True
    stem_channels: tuple[int, ...] = ()
    encoder_channels: tuple[int, ...] = (64, 128, 256, 512, 512)
    encoder_blocks: tuple[int, ...] = (2, 2, 3, 3, 3)
    decoder_channels: tuple[int, ...] = (512, 192, 96, 64, 16)
    boundary_channels: int = 16
    boundary_gating: bool = True
    use_rgb: bool = True
    use_sparse_depth: bool = True
    sparse_depth_gain: float = 1.0

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        if not (self.semantic_head or self.depth_head):
            raise ValueError("a network needs a semantic head, a depth head or both")
        check_counts("stem layers", [len(self.stem_channels)], 0, MAX_STAGES)
        check_counts("encoder stages", [len(self.encoder_channels)], 1, MAX_STAGES)
        check_counts("blocks of a stage", self.encoder_blocks, 1, MAX_BLOCKS)
        check_counts("boundary_channels", [self.boundary_channels])
        for key in ("stem_channels", "encoder_channels", "decoder_channels"):
            check_counts(key, getattr(self, key))
        super().__post_init__()
        if len(self.encoder_channels) != len(self.encoder_blocks):
            raise ValueError("encoder_channels and encoder_blocks must have the same length")
        if len(self.decoder_channels) != self.num_skips:
            raise ValueError(
                f"decoder_channels must have one entry per skip ({self.num_skips}), "
                f"got {len(self.decoder_channels)}"
            )
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

    @property
    def padded(self) -> bool:
        """Whether the image is padded, so that each grid has half the size of the finer one."""
        return bool(self.stem_channels)


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


# The paper's network and its ablations, and the same structure at a fortieth of the parameters,
# for experiments on a CPU: a strided stem instead of the first stage at full size, and narrower.
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


class SSDNet(Network):
    """The paper's network, with all or some of its heads and inputs."""

    config: SSDNetConfig

    def __init__(self, config: SSDNetConfig) -> None:
        self.semantic_stride = self.depth_stride = self.boundary_stride = config.output_stride
        self.stride = config.output_stride * 2**config.num_skips
        self.heads = present_heads(semantic=config.semantic_head, depth=config.depth_head)
        super().__init__(config)
        in_channels = 3 * config.use_rgb + config.use_sparse_depth
        widths = (in_channels, *config.stem_channels)
        self.stem = nn.Sequential(*(ConvBNReLU(*pair, stride=2) for pair in pairwise(widths)))
        self.encoder = PlainEncoder(config, widths[-1])
        self.boundary_decoder = BoundaryDecoder(config.encoder_channels, config.boundary_channels)
        if config.semantic_head:
            self.semantic_decoder = _task_decoder(config)
            self.semantic_head = nn.Conv2d(config.decoder_channels[-1], config.num_scores, 1)
        if config.depth_head:
            self.depth_decoder = _task_decoder(config)
            self.depth_heads = nn.ModuleList(
                nn.Conv2d(channels, 1, 1) for channels in reversed(config.decoder_channels)
            )
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids, see `Network.predict_coarse`.

        A network with a strided stem pads the image to a multiple of its stride; others do not pad.
        """
        config = self.config
        inputs = [self.normalise_rgb(rgb)] if config.use_rgb else []
        if config.use_sparse_depth:
            inputs.append(self.normalise_depth(sparse_depth)[0] * config.sparse_depth_gain)
        if config.padded:
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
        return NetworkOutput(logits, depths, boundary_logits)


def _task_decoder(config: SSDNetConfig) -> TaskDecoder:
    channels, skips = config.decoder_channels, config.encoder_channels
    below = (skips[-1], *channels[:-1])
    sides = zip(below, reversed(skips), channels, strict=True)
    return TaskDecoder(ConcatUpBlock(*side) for side in sides)


class PlainEncoder(nn.Module):
    """VGG's cascaded 3x3 convolutions; every stage is a skip, followed by a 2x2 max-pool.

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
