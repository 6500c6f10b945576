"""SSDNet: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder, a boundary decoder and two task decoders of boundary-aware convolutions.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, pad_to_multiple
from models.network import Network, NetworkOutput, initialise, present_heads
from models.paper.config import SSDNetConfig
from models.paper.decoders import BoundaryDecoder, TaskDecoder


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
        self.boundary_decoder = BoundaryDecoder(config)
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config)
            self.semantic_head = nn.Conv2d(config.decoder_channels[-1], config.num_classes, 1)
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config)
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
