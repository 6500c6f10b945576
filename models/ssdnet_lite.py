"""SSDNetLite: SSDNet for real time, whose depth starts from planes between the returns.

Its layout is the paper's: one encoder, a boundary decoder (section 2.1.2), and two task decoders of
boundary-aware convolutions (Eq. 1, section 2.1.3). It departs from the paper in these parts:

| part | the paper | here | why |
|---|---|---|---|
| encoder | VGG at full size | `EfficientNetLite`, `GlobalContext` | a 62nd of the work |
| skips | concatenated | added, `AddUpBlock` | less work |
| LiDAR | a fourth input channel | `find_candidates`: surfaces and planes | other rigs |
| depth | regressed at five strides | chosen among candidates, `SurfaceDepthHead` | sharp edges |

The grids of a frame, in the order of `SSDNetLite.predict_coarse`:

| stride | tensor | channels |
|---|---|---|
| 2, 4 | `EfficientNetLite.early` | 16, 24 |
| 2, 4 | `find_candidates`: the base; surfaces and their features, embedded and added at 4 | 1; 6 |
| 8, 16, 32 | `EfficientNetLite.late`; `GlobalContext` at 32 | 40, 112, 320 |
| 4 | `BoundaryDecoder`: boundary and, at 4, 8 and 16, the gates of both task decoders | 1 |
| 16, 8, 4 | `TaskDecoder` of the classes, then of the depth | 64, 48, 32 |
| 2 | `semantic_refine` and the class scores | 16, 11 |
| 4, 2, 1 | `SurfaceDepthHead`: geometry at 4, choice and base at 2, returns at 1 | 16; 16; 1 |

`docs/network.png` shows these grids (`benchmarks/network_figure.py` draws it from the modules).
`ssdnet-nano` has no features at stride 2 except the encoder's: it classifies and chooses at 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.blocks import GlobalContext, pad_to_multiple, upsample
from models.decoders import AddUpBlock, BoundaryDecoder, TaskDecoder
from models.efficientnet_lite import CHANNELS, WIDTHS, EfficientNetLite
from models.network import (
    Network,
    NetworkConfig,
    NetworkOutput,
    check_counts,
    initialise,
    present_heads,
)
from models.picture import picture_shows
from models.planes import CELL
from models.surface_depth import SurfaceDepthHead
from models.surfaces import find_candidates

_LITE_WIDTHS = (32, 48, 80, 80, 160, 160, *[320] * 3, *[480] * 3, *[896] * 3, 640)
# Strides of the skips, and of the bottom.
_SKIPS, _BOTTOM = (4, 8, 16), 32
# Channels of a side output of the boundary decoder.
_SIDE_CHANNELS = 16


@dataclass(frozen=True)
class SSDNetLiteConfig(NetworkConfig):
    """The configuration of an `SSDNetLite`; the defaults are `ssdnet-lite`.

    Attributes:
        encoder_widths: channels of the encoder's stem and within each block, as pruning left them;
            () = all, `models.efficientnet_lite.WIDTHS`.
        fused_start: whether the encoder begins with fewer, dense convolutions, see
            `EfficientNetLite`.
        decoder_channels: channels of the decoders at strides 16, 8 and 4.
        semantic_refine_channels, depth_refine_channels: channels at stride 2 of the classes and of
            the depth; 0 = none: the prediction is made at stride 4. Poles and signs are thinner
            than a cell of the coarser grid.
        separable_from: from this stride on, the BaConvs of the depth's decoder are separable, and
            the convolutions of the boundary's side outputs; 0 = none is. Those of the classes are
            at stride 2 alone: thin classes need dense ones before it.
        geometry_channels: channels of the convolutions that read the geometry of the returns, at
            stride 4.
        farthest_guess_m: largest depth [m] that the network predicts without a return; farther true
            depth is not trained. It is also the depth of the sky.

        judges_picture: whether the depth is that of the returns alone if the picture is blurred,
            dark, overexposed or noise, see `models.picture`.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet-lite"
    max_depth_m: float = 200.0
    semantic_head: bool = True
    depth_head: bool = True
    encoder_widths: tuple[int, ...] = _LITE_WIDTHS
    fused_start: bool = False
    decoder_channels: tuple[int, ...] = (64, 48, 32)
    semantic_refine_channels: int = 16
    depth_refine_channels: int = 16
    separable_from: int = 4
    geometry_channels: int = 16
    farthest_guess_m: float = 100.0
    judges_picture: bool = False

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        if not (self.semantic_head or self.depth_head):
            raise ValueError("a network needs a semantic head, a depth head or both")
        check_counts("encoder_widths", self.encoder_widths)
        check_counts("decoder_channels", self.decoder_channels)
        for key in ("semantic_refine_channels", "depth_refine_channels", "separable_from"):
            check_counts(key, [getattr(self, key)], least=0)
        check_counts("geometry_channels", [self.geometry_channels])
        super().__post_init__()
        if len(self.decoder_channels) != len(_SKIPS):
            raise ValueError(
                f"decoder_channels must have one entry per skip ({len(_SKIPS)}), "
                f"got {len(self.decoder_channels)}"
            )

    @property
    def unmeasured_range_m(self) -> float:
        """See `NetworkConfig`."""
        return min(self.farthest_guess_m, self.max_depth_m)


SSDNET_NANO = SSDNetLiteConfig(
    name="ssdnet-nano",
    encoder_widths=(16, 24, 32, 32, 72, 72, *[144] * 3, *[208] * 3, *[352] * 4),
    decoder_channels=(32, 16, 16),
    semantic_refine_channels=0,
    depth_refine_channels=0,
    separable_from=0,
)


class SSDNetLite(Network):
    """The real-time network, with both task decoders or one of them.

    Without a depth head the sparse depth is not read.
    """

    config: SSDNetLiteConfig
    stride = _BOTTOM
    shared_depth_layers = ("surface_depth.embed",)  # the encoder reads their output

    def __init__(self, config: SSDNetLiteConfig) -> None:
        heads = present_heads(semantic=config.semantic_head, depth=config.depth_head)
        self.heads = (*heads, *(("depth_uncertainty",) if config.depth_head else ()))
        self.semantic_stride = 2 if config.semantic_refine_channels else CELL
        # The boundary is upsampled with the depth.
        self.depth_stride = self.boundary_stride = 1 if config.depth_head else CELL
        self.depth_layers = ("depth_decoder", "surface_depth") if config.depth_head else ()
        super().__init__(config)
        self.encoder = EfficientNetLite(
            config.encoder_widths or WIDTHS, fused_start=config.fused_start
        )
        self.context = GlobalContext(CHANNELS[_BOTTOM])
        self.boundary_decoder = BoundaryDecoder(
            [CHANNELS[stride] for stride in _SKIPS],
            _SIDE_CHANNELS,
            separable=config.separable_from > 0,
            halved=True,
        )
        if config.semantic_head:
            finest, refined = config.decoder_channels[-1], config.semantic_refine_channels
            self.semantic_decoder = _task_decoder(config.decoder_channels)
            self.semantic_head = nn.Conv2d(refined or finest, config.num_scores, 1)
            if refined:
                # Without the prediction at stride 4 the few channels at stride 2 would hold all of
                # it, which takes longer to learn.
                self.semantic_coarse_head = nn.Conv2d(finest, config.num_scores, 1)
                self.semantic_refine = AddUpBlock(
                    finest, CHANNELS[2], refined, separable=config.separable_from >= 2
                )
        if config.depth_head:
            self.depth_decoder = _task_decoder(
                config.decoder_channels, separable_from=config.separable_from
            )
            self.surface_depth = SurfaceDepthHead(
                config.decoder_channels[-1],
                CHANNELS[2],
                CHANNELS[4],
                refine_channels=config.depth_refine_channels,
                separable=config.separable_from >= 2,
                geometry_channels=config.geometry_channels,
                semantics=config.semantic_head,
                max_depth_m=config.max_depth_m,
                unmeasured_share=config.unmeasured_range_m / config.max_depth_m,
            )
        self.apply(initialise)
        if config.depth_head:
            self.surface_depth.initialise_as_base()

    def predict_coarse(self, rgb: Tensor, sparse_depth: Tensor) -> NetworkOutput:
        """Predict on the heads' own grids of the padded image, see `Network.predict_coarse`."""
        stride2, stride4 = self.encoder.early(pad_to_multiple(self.normalise_rgb(rgb), self.stride))
        candidates = None
        if self.config.depth_head:
            padded = pad_to_multiple(sparse_depth, self.stride)
            depth, mask = self.normalise_depth(padded)
            candidates = find_candidates(
                depth, mask.to(depth.dtype), max_depth_m=self.config.max_depth_m
            )
            stride4 = stride4 + self.surface_depth.embed(candidates.features)
        *skips, bottom = stride4, *self.encoder.late(stride4)
        bottom = self.context(bottom)
        boundary_logits, sides = self.boundary_decoder(skips)
        gates = [torch.sigmoid(side) for side in sides]
        semantics = logits = None
        if self.config.semantic_head:
            semantics, *_ = self.semantic_decoder(bottom, skips, gates)
            logits = self._classify(semantics, stride2)
        if candidates is None:
            return NetworkOutput(logits, boundary_logits=boundary_logits)
        features, *_ = self.depth_decoder(bottom, skips, gates)
        shows = picture_shows(rgb) if self.config.judges_picture else None
        maps = self.surface_depth(candidates, features, semantics, stride2, boundary_logits, shows)
        return NetworkOutput(logits, (maps.depth,), maps.boundary_logits, maps.scale)

    def _classify(self, semantics: Tensor, stride2: Tensor) -> Tensor:
        """Return the class scores on the grid of `semantic_stride`."""
        logits: Tensor
        if self.config.semantic_refine_channels:
            logits = self.semantic_head(self.semantic_refine(semantics, stride2))
            return logits + upsample(self.semantic_coarse_head(semantics))
        logits = self.semantic_head(semantics)
        return logits


def _task_decoder(channels: Sequence[int], *, separable_from: int = 0) -> TaskDecoder:
    """Return a decoder of these channels at strides 16, 8 and 4, see `SSDNetLiteConfig`."""
    below = (CHANNELS[_BOTTOM], *channels[:-1])
    return TaskDecoder(
        AddUpBlock(coarser, CHANNELS[stride], finer, separable=stride <= separable_from)
        for coarser, stride, finer in zip(below, reversed(_SKIPS), channels, strict=True)
    )
