"""SSDNetLite: SSDNet for real time, with a depth head that chooses among measured surfaces.

A strided encoder, decoders that add their skips, and what LiDAR returns show around each pixel
(`models.surfaces`) beside the features and in the depth head.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor, nn

from models.blocks import GlobalContext, pad_to_multiple
from models.boundary_decoder import BoundaryDecoder
from models.encoder_decoder import MAX_CHANNELS, EncoderDecoderConfig
from models.lite_encoder import LiteEncoder, ResidualEncoder
from models.network import Network, NetworkOutput, initialise
from models.surface_depth import Candidates, SurfaceDepthHead
from models.surfaces import COARSE_CELL
from models.task_decoder import TaskDecoder, refinement
from runtime.contract import check_max_depth


@dataclass(frozen=True)
class SSDNetLiteConfig(EncoderDecoderConfig):
    """The configuration of an `SSDNetLite`; the defaults are ssdnet-lite.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet-lite"
    max_depth_m: float = 200.0
    #: "residual": a stem of two strided convolutions, then residual stages, both of the channels
    #: and blocks given here; the last stage is the bottom, the others are skips.
    encoder: Literal["residual"] = "residual"
    stem_channels: tuple[int, ...] = (16, 32)
    encoder_channels: tuple[int, ...] = (32, 64, 128, 256)
    encoder_blocks: tuple[int, ...] = (1, 2, 2, 2)
    decoder_channels: tuple[int, ...] = (64, 48, 32)
    #: Channels of one more UpBlock of the semantic decoder, at stride 2; 0 = none. Poles and signs
    #: are thinner than a cell of the coarser grid.
    semantic_refine_channels: int = 16
    #: Channels of one more UpBlock of the depth decoder, at stride 2, for the choice among
    #: surfaces; 0 = none, the choice is made at stride 4.
    depth_refine_channels: int = 16
    #: Depth [m] that the regression reaches at most, without the surfaces that returns show; None =
    #: `max_depth_m`.
    regressed_depth_m: float | None = 100.0
    #: Add the projected global mean of the bottom features to them.
    global_context: bool = True

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        super().__post_init__()
        if self.regressed_depth_m is not None:
            check_max_depth(self.regressed_depth_m, "regressed_depth_m")

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """See `EncoderDecoderConfig`."""
        return {
            **super().counts(),
            "stem layers": (len(self.stem_channels), 2, 2),
            "semantic_refine_channels": (self.semantic_refine_channels, 0, MAX_CHANNELS),
            "depth_refine_channels": (self.depth_refine_channels, 0, MAX_CHANNELS),
        }

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        return len(self.encoder_channels) - 1

    @property
    def target_depth_m(self) -> float:
        """See `NetworkConfig`."""
        return min(self.regressed_depth_m or self.max_depth_m, self.max_depth_m)


class SSDNetLite(Network):
    """The real-time network, with both task decoders or one of them.

    Without a depth head it has no candidate surfaces: the sparse depth is an input only.
    """

    config: SSDNetLiteConfig

    def __init__(self, config: SSDNetLiteConfig) -> None:
        super().__init__(config)
        self.encoder = build_encoder(config)
        at_2, at_4 = self.encoder.early_channels
        *skip_list, bottom = self.encoder.late_channels
        skips = tuple(skip_list)
        self.context = GlobalContext(bottom) if config.global_context else nn.Identity()
        self.boundary_decoder = BoundaryDecoder(skips, config.boundary_channels, padded=True)
        finest = config.decoder_channels[-1]
        if config.semantic_head:
            self.semantic_decoder = TaskDecoder(config.decoder_channels, skips, bottom, "add")
            refined = config.semantic_refine_channels
            self.semantic_refine = refinement(finest, at_2, refined)
            self.semantic_head = nn.Conv2d(refined or finest, config.num_classes, 1)
        if config.depth_head:
            self.depth_decoder = TaskDecoder(config.decoder_channels, skips, bottom, "add")
            self.depth_heads = nn.ModuleList(
                nn.Conv2d(channels, 1, 1) for channels in reversed(config.decoder_channels)
            )
            self.surface_depth = SurfaceDepthHead(
                finest,
                at_2_channels=at_2,
                at_4_channels=at_4,
                refine_channels=config.depth_refine_channels,
                use_semantics=config.semantic_head,
                levels=config.num_skips,
                max_depth_m=config.max_depth_m,
                reach=config.target_share,
            )
        self.apply(initialise)
        if config.depth_head:
            self.surface_depth.ignore_semantics()

    @property
    def heads(self) -> tuple[str, ...]:
        """The network's heads; a boundary always."""
        semantic, depth = self.config.semantic_head, self.config.depth_head
        present = {
            "semantic": semantic,
            "depth": depth,
            "boundary": True,
            "depth_uncertainty": depth,
        }
        return tuple(head for head, there in present.items() if there)

    @property
    def stride(self) -> int:
        """Ratio of the image to the coarsest grid."""
        return int(COARSE_CELL * 2**self.config.num_skips)

    @property
    def semantic_stride(self) -> int:
        """Ratio of the image to the grid of the semantic logits."""
        return 2 if self.config.semantic_refine_channels else COARSE_CELL

    @property
    def depth_stride(self) -> int:
        """Ratio of the image to the grid of the finest depth."""
        return 1 if self.config.depth_head else COARSE_CELL

    @property
    def boundary_stride(self) -> int:
        """Ratio of the image to the grid of the boundary, which is upsampled with the depth."""
        return self.depth_stride

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
        if candidates is not None:
            features = self.depth_decoder(bottom, skips, gates)
            depths = self._regress(features)
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

    def _regress(self, features: list[Tensor]) -> tuple[Tensor, ...]:
        """The normalised depths without the surfaces, finest first."""
        pairs = zip(self.depth_heads, features, strict=True)
        return tuple(
            self.config.target_share * torch.sigmoid(head(feature)) for head, feature in pairs
        )


def build_encoder(config: SSDNetLiteConfig) -> LiteEncoder:
    """Return the encoder that ``config.encoder`` names; a new one is a row."""
    return {
        "residual": lambda: ResidualEncoder(
            config.stem_channels, config.encoder_channels, config.encoder_blocks
        )
    }[config.encoder]()


SSDNET_LITE = SSDNetLiteConfig()

SSDNET_NANO = replace(
    SSDNET_LITE,
    name="ssdnet-nano",
    stem_channels=(16, 16),
    encoder_channels=(16, 48, 96, 160),
    encoder_blocks=(1, 1, 2, 2),
    decoder_channels=(32, 16, 16),
    semantic_refine_channels=0,
    depth_refine_channels=0,
)
