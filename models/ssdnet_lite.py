"""SSDNetLite: SSDNet for real time, with a depth head that chooses among measured surfaces.

A strided encoder, decoders that add their skips, and what LiDAR returns show around each pixel
(`models.surfaces`) beside the features and in the depth head.
"""

import torch
from torch import Tensor, nn

from models.blocks import GlobalContext, pad_to_multiple, upsample
from models.boundary_decoder import BoundaryDecoder
from models.lite_encoder import ENCODERS
from models.network import Network, NetworkOutput, initialise
from models.ssdnet_config import SSDNetLiteConfig
from models.surfaces import COARSE_CELL, Candidates, SurfaceDepthHead
from models.task_decoder import TaskDecoder, refinement


class SSDNetLite(Network):
    """The real-time network, with both task decoders or one of them.

    Without a depth head it has no candidate surfaces: the sparse depth is an input only.
    """

    config: SSDNetLiteConfig

    def __init__(self, config: SSDNetLiteConfig) -> None:
        self.heads = (*config.heads, *(("depth_uncertainty",) if config.depth_head else ()))
        self.stride = COARSE_CELL * 2**config.num_skips
        self.semantic_stride = 2 if config.semantic_refine_channels else COARSE_CELL
        # The boundary is upsampled with the depth.
        self.depth_stride = self.boundary_stride = 1 if config.depth_head else COARSE_CELL
        super().__init__(config)
        self.encoder = ENCODERS[config.encoder](config)
        at_2, at_4 = self.encoder.early_channels
        *skip_list, bottom = self.encoder.late_channels
        skips = tuple(skip_list)
        self.context = GlobalContext(bottom) if config.global_context else nn.Identity()
        self.boundary_decoder = BoundaryDecoder(config, skips)
        finest, linear = config.decoder_channels[-1], self.encoder.linear
        self.semantic_coarse_head = None
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config, skips, bottom, "add", linear=linear)
            refined = config.semantic_refine_channels
            self.semantic_refine = refinement(finest, at_2, refined, linear=linear)
            self.semantic_head = nn.Conv2d(refined or finest, config.num_classes, 1)
            if refined and config.additive_refinement:
                self.semantic_coarse_head = nn.Conv2d(finest, config.num_classes, 1)
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config, skips, bottom, "add", linear=linear)
            self.depth_heads = nn.ModuleList(
                nn.Conv2d(channels, 1, 1) for channels in reversed(config.decoder_channels)
            )
            self.surface_depth = SurfaceDepthHead(config, at_2, at_4, linear=linear)
        self.apply(initialise)
        if config.depth_head:
            self.surface_depth.ignore_semantics()

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids of the padded image, see `Network.predict_coarse`."""
        at_2, at_4, candidates = self._start(rgb, sparse_depth)
        *skips, bottom = self.encoder.late(at_4)
        bottom = self.context(bottom)
        boundary_logits, sides = self.boundary_decoder(skips)
        gates = [torch.sigmoid(side) if self.config.boundary_gating else None for side in sides]
        semantics = logits = depths = scale = None
        if self.config.semantic_head:
            semantics = self.semantic_decoder(bottom, skips, gates)[0]
            logits = self.semantic_head(self.semantic_refine(semantics, at_2))
            if self.semantic_coarse_head is not None:
                logits = logits + upsample(self.semantic_coarse_head(semantics))
        if candidates is not None:
            features = self.depth_decoder(bottom, skips, gates)
            # Without the surfaces, finest first.
            pairs = zip(self.depth_heads, features, strict=True)
            share = self.config.target_share
            depths = tuple(share * torch.sigmoid(head(feature)) for head, feature in pairs)
            depth, scale, boundary_logits = self.surface_depth(
                candidates, features[0], semantics, at_2, depths[0], boundary_logits
            )
            depths = (depth, *depths)
        return NetworkOutput(logits, depths, boundary_logits, tuple(sides), scale)

    def _start(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, Tensor, Candidates | None]:
        """Return the features at strides 2 and 4, and what the returns show."""
        depth, valid_mask = self.normalise_depth(sparse_depth)
        inputs = (self.normalise_rgb(rgb), depth, valid_mask.to(depth.dtype))
        rgb, depth, mask = (pad_to_multiple(x, self.stride) for x in inputs)
        if not self.config.depth_head:
            return *self.encoder.early(rgb, depth, mask), None
        candidates = self.surface_depth.propagate(depth, mask)
        at_2, at_4 = self.encoder.early(rgb, candidates.measured.depth, candidates.measured.mask)
        return at_2, at_4 + self.surface_depth.embed(candidates.features), candidates
