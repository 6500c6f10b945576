"""SSDNet: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder, a boundary decoder and two task decoders of boundary-aware convolutions.
"""

import torch
from torch import Tensor, nn

from models.blocks import ConvBNReLU, pad_to_multiple, upsample
from models.boundary_decoder import BoundaryDecoder
from models.depth_prior import DepthPrior, pull_push_fill
from models.encoder import build_encoder
from models.network import Network, SSDNetOutput, initialise
from models.ssdnet_config import SSDNetConfig
from models.surfaces import Surfaces, choose_surface, gather_surfaces, keep_measurements
from models.task_decoder import TaskDecoder, UpBlock


class SSDNet(Network):
    """Every member of the family, built from its configuration."""

    config: SSDNetConfig

    def __init__(self, config: SSDNetConfig) -> None:
        super().__init__(config)
        width = 3 * config.use_rgb + config.use_sparse_depth * (1 + config.valid_mask_input)
        stem: list[nn.Module] = []
        for channels in config.stem_channels:
            stem.append(ConvBNReLU(width, channels, stride=2))
            width = channels
        self.stem = nn.Sequential(*stem)
        self.prior_stem = (
            nn.Conv2d(len(DepthPrior._fields), width, 1) if config.depth_prior else None
        )
        self.encoder = build_encoder(config, width)
        skips, bottom = self.encoder.skip_channels, self.encoder.bottom_channels
        self.boundary_decoder = BoundaryDecoder(skips, config.boundary_channels)

        finest = config.decoder_channels[-1]
        self.semantic_decoder = self.semantic_refine = self.semantic_head = None
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config, skips, bottom)
            width = finest
            if config.semantic_refine_channels:
                width = config.semantic_refine_channels
                self.semantic_refine = UpBlock(
                    finest, config.stem_channels[0], width, config.skip_fusion
                )
            self.semantic_head = nn.Conv2d(width, config.num_classes, 1)
        self.depth_decoder = self.depth_heads = self.depth_refine = None
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config, skips, bottom)
            if config.depth_refine_channels:
                width = config.depth_refine_channels
                self.depth_refine = UpBlock(
                    finest, config.stem_channels[0], width, config.skip_fusion
                )
                self.surface_features = nn.Conv2d(len(Surfaces._fields), width, 1)
                self.surface_block = ConvBNReLU(width, width)
                self.surface_head = nn.Conv2d(width, 4, 1)
            self.depth_heads = nn.ModuleList(
                # With a prior the finest head says a correction and how far to trust the prior.
                nn.Conv2d(channels, 2 if config.depth_prior and scale == 0 else 1, 1)
                for scale, channels in enumerate(reversed(config.decoder_channels))
            )
        self.apply(initialise)

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> SSDNetOutput:
        """Predict on the heads' own grids, see `Network.predict_coarse`.

        A network with a strided stem pads the image to a multiple of its stride; the others do
        not pad.
        """
        config = self.config
        exact = bool(config.stem_channels)
        depth, valid_mask = self.normalise_depth(sparse_depth)
        inputs = []
        if config.use_rgb:
            inputs.append(self.normalise_rgb(rgb))
        if config.use_sparse_depth:
            inputs.append(depth * config.sparse_depth_gain)
            if config.valid_mask_input:
                inputs.append(valid_mask.to(depth.dtype))
        x = torch.cat(inputs, dim=1)
        if exact:
            x = pad_to_multiple(x, config.stride)
        prior = None
        stem_features = [x]
        for layer in self.stem:
            stem_features.append(layer(stem_features[-1]))
        x_stem = stem_features[-1]
        if self.prior_stem is not None:
            prior = pull_push_fill(
                x[:, -2:],  # depth and mask, padded
                factor=config.output_stride,
                levels=config.num_skips,
            )
            x_stem = x_stem + self.prior_stem(torch.cat(prior, dim=1))

        skips, bottom = self.encoder(x_stem)
        boundary_logits, sides = self.boundary_decoder(skips, exact=exact)
        boundaries: list[Tensor] | list[None] = [None] * len(sides)
        if config.boundary_gating:
            boundaries = [torch.sigmoid(side) for side in sides]

        semantic_logits = None
        if self.semantic_decoder is not None and self.semantic_head is not None:
            finest = self.semantic_decoder(bottom, skips, boundaries, exact=exact)[0]
            if self.semantic_refine is not None:
                gate = None if boundaries[0] is None else upsample(boundaries[0])
                finest = self.semantic_refine(finest, stem_features[1], gate, exact=exact)
            semantic_logits = self.semantic_head(finest)
        depths = None
        if self.depth_decoder is not None and self.depth_heads is not None:
            features = self.depth_decoder(bottom, skips, boundaries, exact=exact)
            logits = [
                head(feature) for head, feature in zip(self.depth_heads, features, strict=True)
            ]
            if prior is not None:
                logits[0] = _refine(logits[0], prior)
            depths = tuple(torch.sigmoid(logit) for logit in logits)
            if self.depth_refine is not None:
                gate = None if boundaries[0] is None else upsample(boundaries[0])
                finest = self.depth_refine(features[0], stem_features[1], gate, exact=exact)
                depths = (self._choose_surface(finest, depths[0], x[:, -2:]), *depths)
        return SSDNetOutput(semantic_logits, depths, boundary_logits, tuple(sides))

    def _choose_surface(self, features: Tensor, regressed: Tensor, measured: Tensor) -> Tensor:
        """Depth at full size from features (N, C, h, w) on the grid of the stem's first layer."""
        surfaces = gather_surfaces(measured, factor=2, levels=self.config.num_skips + 1)
        features = features + self.surface_features(surfaces.features())
        head = self.surface_head(self.surface_block(features)).float()
        depth = choose_surface(head, upsample(regressed.float()), surfaces)
        return keep_measurements(upsample(depth), measured)


def _refine(head: Tensor, prior: DepthPrior) -> Tensor:
    """Logit of the depth: a correction plus the prior's logit as far as it is trusted.

    Where nothing supports the prior its share is 0 and the correction alone is the answer.
    """
    correction, trust = head[:, :1], head[:, 1:]
    filled = prior.filled.clamp(1e-3, 1.0 - 1e-3)
    prior_logit = torch.log(filled / (1.0 - filled))
    return correction + torch.sigmoid(trust) * prior.support * prior_logit
