"""SSDNet: semantics, depth and boundaries from one image and one sparse depth map.

Paper: "Simultaneous Semantic Segmentation and Depth Completion with Constraint of Boundary",
Sensors 2020. One encoder, a boundary decoder and two task decoders of boundary-aware convolutions.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.blocks import ConvBNReLU, pad_to_multiple, upsample
from models.boundary_decoder import BoundaryDecoder
from models.encoder import build_encoder
from models.network import Network, NetworkOutput, initialise
from models.ssdnet_config import SSDNetConfig
from models.surfaces import (
    COARSE_CELL,
    FEATURE_CHANNELS,
    FINE_CELL,
    HEAD_CHANNELS,
    Measured,
    Surfaces,
    choose_surface,
    dilate_returns,
    measure,
    propagate_surfaces,
    refine_surfaces,
    return_confidence,
    surface_features,
    take_returns,
)
from models.task_decoder import TaskDecoder, UpBlock


class SSDNet(Network):
    """Every member of the family, built from its configuration."""

    config: SSDNetConfig

    def __init__(self, config: SSDNetConfig) -> None:
        super().__init__(config)
        in_channels = 3 * config.use_rgb + config.use_sparse_depth * (1 + config.valid_mask_input)
        stem: list[nn.Module] = []
        for channels in config.stem_channels:
            stem.append(ConvBNReLU(in_channels, channels, stride=2))
            in_channels = channels
        self.stem = nn.Sequential(*stem)
        self.surface_stem = (
            nn.Conv2d(FEATURE_CHANNELS, in_channels, 1) if config.depth_surfaces else None
        )
        self.encoder = build_encoder(config, in_channels)
        skips, bottom = self.encoder.skip_channels, self.encoder.bottom_channels
        self.boundary_decoder = BoundaryDecoder(skips, config.boundary_channels)

        finest = config.decoder_channels[-1]
        self.semantic_decoder = self.semantic_refine = self.semantic_head = None
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config, skips, bottom)
            channels = finest
            if config.semantic_refine_channels:
                channels = config.semantic_refine_channels
                self.semantic_refine = UpBlock(
                    finest, config.stem_channels[0], channels, config.skip_fusion
                )
            self.semantic_head = nn.Conv2d(channels, config.num_classes, 1)
        self.depth_decoder = self.depth_heads = self.depth_refine = None
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config, skips, bottom)
            self.depth_heads = nn.ModuleList(
                nn.Conv2d(channels, 1, 1) for channels in reversed(config.decoder_channels)
            )
        if config.depth_surfaces:
            self.surface_project = nn.Conv2d(FEATURE_CHANNELS, finest, 1)
            # Classes imply surfaces without returns: a car has a roof and windows.
            self.surface_semantics = nn.Conv2d(finest, finest, 1) if config.semantic_head else None
            channels = finest
            if config.depth_refine_channels:
                channels = config.depth_refine_channels
                self.depth_refine = UpBlock(
                    finest, config.stem_channels[0], channels, config.skip_fusion
                )
            self.surface_head = nn.Conv2d(channels, HEAD_CHANNELS, 1)
        self.apply(initialise)
        if config.depth_surfaces and self.surface_semantics is not None:
            # Zero, so that weights trained without this layer give the same depth.
            nn.init.zeros_(self.surface_semantics.weight)

    @property
    def heads(self) -> tuple[str, ...]:
        """The network's heads; a boundary always."""
        config = self.config
        present: dict[str, bool] = {
            "semantic": config.semantic_head,
            "depth": config.depth_head,
            "boundary": True,
            "depth_uncertainty": config.depth_surfaces,
        }
        return tuple(head for head, there in present.items() if there)

    @property
    def stride(self) -> int:
        """Ratio of the image to the coarsest grid."""
        return int(self.config.output_stride * 2**self.config.num_skips)

    @property
    def semantic_stride(self) -> int:
        """Ratio of the image to the grid of the semantic logits."""
        return 2 if self.config.semantic_refine_channels else self.config.output_stride

    @property
    def depth_stride(self) -> int:
        """Ratio of the image to the grid of the finest depth."""
        return 1 if self.config.depth_surfaces else self.config.output_stride

    @property
    def boundary_stride(self) -> int:
        """Ratio of the image to the grid of the boundary, which is upsampled with the depth."""
        return self.depth_stride

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids, see `Network.predict_coarse`.

        A network with a strided stem pads the image to a multiple of its stride, others do not.
        """
        config = self.config
        exact = bool(config.stem_channels)
        inputs = []
        if config.use_rgb:
            inputs.append(self.normalise_rgb(rgb))
        if config.use_sparse_depth:
            depth, valid_mask = self.normalise_depth(sparse_depth)
            inputs.append(depth * config.sparse_depth_gain)
            if config.valid_mask_input:
                inputs.append(valid_mask.to(depth.dtype))
        if exact:
            inputs = [pad_to_multiple(x, self.stride) for x in inputs]
        measured = None
        if config.depth_surfaces:
            measured = measure(*inputs[-2:], max_depth_m=config.max_depth_m)
            inputs[-2:] = measured.depth, measured.mask
        x = torch.cat(inputs, dim=1)
        stem_features = [x]
        for layer in self.stem:
            stem_features.append(layer(stem_features[-1]))
        x_stem = stem_features[-1]
        surfaces = cues = None
        if self.surface_stem is not None and measured is not None:
            surfaces, density = propagate_surfaces(measured, levels=config.num_skips)
            cues = surface_features(surfaces, density)
            x_stem = x_stem + self.surface_stem(cues)

        skips, bottom = self.encoder(x_stem)
        boundary_logits, sides = self.boundary_decoder(skips, exact=exact)
        boundaries: list[Tensor] | list[None] = [None] * len(sides)
        if config.boundary_gating:
            boundaries = [torch.sigmoid(side) for side in sides]

        semantic_logits = semantics = None
        if self.semantic_decoder is not None and self.semantic_head is not None:
            semantics = finest = self.semantic_decoder(bottom, skips, boundaries, exact=exact)[0]
            if self.semantic_refine is not None:
                finest = self.semantic_refine(finest, stem_features[1], None, exact=exact)
            semantic_logits = self.semantic_head(finest)
        depths = uncertainty = None
        if self.depth_decoder is not None and self.depth_heads is not None:
            features = self.depth_decoder(bottom, skips, boundaries, exact=exact)
            depths = tuple(
                config.target_share * torch.sigmoid(head(feature))
                for head, feature in zip(self.depth_heads, features, strict=True)
            )
            if surfaces is not None and measured is not None:
                finest = features[0] + self.surface_project(cues)
                if self.surface_semantics is not None:
                    finest = finest + self.surface_semantics(semantics)
                if self.depth_refine is not None:
                    finest = self.depth_refine(finest, stem_features[1], None, exact=exact)
                depth, uncertainty, boundary_logits = self._complete_depth(
                    self.surface_head(finest), depths[0], surfaces, measured, boundary_logits
                )
                depths = (depth, *depths)
        return NetworkOutput(semantic_logits, depths, boundary_logits, tuple(sides), uncertainty)

    def _complete_depth(
        self,
        head: Tensor,
        regressed: Tensor,
        surfaces: Surfaces,
        measured: Measured,
        boundary_logits: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the depth, its uncertainty and the boundary's logits at full size.

        One upsampling for all maps of a grid: ONNX Runtime splits the work of a Resize by channels.
        """
        head, regressed = head.float(), regressed.float()
        boundary_logits = boundary_logits.float()
        stride = COARSE_CELL
        if self.depth_refine is not None:
            stride = FINE_CELL
            maps = torch.cat([*surfaces, regressed, boundary_logits], dim=1)
            maps = upsample(maps, factor=COARSE_CELL // FINE_CELL)
            *upsampled, regressed, boundary_logits = maps.split(1, dim=1)
            surfaces = refine_surfaces(Surfaces(*upsampled), measured)
        depth, scale = choose_surface(head, regressed, surfaces, reach=self.config.target_share)
        maps = upsample(torch.cat([depth, scale, boundary_logits], dim=1), factor=stride)
        depth, scale, boundary_logits = maps.split(1, dim=1)
        # One value a cell is enough: the returns give the position of an edge.
        confidence = F.interpolate(
            return_confidence(head), scale_factor=float(stride), mode="nearest"
        )
        depth, scale = take_returns(
            depth, scale, dilate_returns(measured), confidence, max_depth_m=self.config.max_depth_m
        )
        return depth, scale, boundary_logits
