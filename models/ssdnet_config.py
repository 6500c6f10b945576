"""The configurations of `SSDNet` and `SSDNetLite`, and their named members."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from models.network import NetworkConfig
from runtime.contract import check_max_depth

# Limits, far beyond any network in use.
MAX_STAGES = 8
MAX_BLOCKS = 100
MAX_CHANNELS = 8192


@dataclass(frozen=True)
class EncoderDecoderConfig(NetworkConfig):
    """What both have: one encoder, a boundary decoder and two task decoders.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    semantic_head: bool = True
    depth_head: bool = True
    #: Channels of 3x3 stride-2 convolutions in front of the first stage; () starts at full size.
    stem_channels: tuple[int, ...] = ()
    #: Channels and blocks of each encoder stage, fine to coarse.
    encoder_channels: tuple[int, ...] = ()
    encoder_blocks: tuple[int, ...] = ()
    #: Channels of the UpBlocks, coarse to fine: one for each skip.
    decoder_channels: tuple[int, ...] = ()
    boundary_channels: int = 16
    #: Gate the decoders by 1 - B (Eq. 1); without it B = 0 and a BaConv is a plain convolution.
    boundary_gating: bool = True

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        if not (self.semantic_head or self.depth_head):
            raise ValueError("a network needs a semantic head, a depth head or both")
        for what, (count, least, most) in self.counts().items():
            if not least <= count <= most:
                raise ValueError(f"{what}: expected {least} to {most}, got {count}")
        super().__post_init__()
        if len(self.encoder_channels) != len(self.encoder_blocks):
            raise ValueError("encoder_channels and encoder_blocks must have the same length")
        if len(self.decoder_channels) != self.num_skips:
            raise ValueError(
                f"decoder_channels must have one entry per skip ({self.num_skips}), "
                f"got {len(self.decoder_channels)}"
            )

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        raise NotImplementedError

    @property
    def padded(self) -> bool:
        """Whether the image is padded, so that each grid has half the size of the finer one."""
        return bool(self.stem_channels)

    @property
    def heads(self) -> tuple[str, ...]:
        """Names of the heads that both networks have; a boundary always."""
        present = {"semantic": self.semantic_head, "depth": self.depth_head, "boundary": True}
        return tuple(head for head, there in present.items() if there)

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """Numbers of layers and channels, with the least and the most that can be built."""
        counts = {
            "stem layers": (len(self.stem_channels), 0, MAX_STAGES),
            "encoder stages": (len(self.encoder_channels), 1, MAX_STAGES),
            "blocks of a stage": (max(self.encoder_blocks, default=1), 1, MAX_BLOCKS),
            "boundary_channels": (self.boundary_channels, 1, MAX_CHANNELS),
        }
        for key in ("stem_channels", "encoder_channels", "decoder_channels"):
            for channels in getattr(self, key):
                counts[f"{key} {channels}"] = (channels, 1, MAX_CHANNELS)
        return counts


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


@dataclass(frozen=True)
class SSDNetLiteConfig(EncoderDecoderConfig):
    """The configuration of an `SSDNetLite`; the defaults have a residual encoder.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet-lite"
    max_depth_m: float = 200.0
    #: "residual": a stem of two strided convolutions, then residual stages, both of the channels
    #: and blocks given here; the last stage is the bottom, the others are skips.
    #: "efficientnet-lite0": that trunk; returns enter at stride 4 alone.
    encoder: Literal["residual", "efficientnet-lite0"] = "residual"
    #: Channels of the stem and within each block of "efficientnet-lite0", as pruning left them; ()
    #: = all, `models.efficientnet_lite.WIDTHS`.
    encoder_widths: tuple[int, ...] = ()
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
    #: Both heads also predict at stride 4, and the prediction at stride 2 is added to it. Without
    #: this the few channels at stride 2 hold the whole prediction, which takes longer to learn.
    #: Ignored by a head without refinement.
    additive_refinement: bool = False
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
        if self.encoder_widths and self.encoder == "residual":
            raise ValueError("encoder_widths needs encoder = 'efficientnet-lite0'")
        if self.encoder != "residual":
            for key in ("stem_channels", "encoder_channels", "encoder_blocks"):
                if getattr(self, key) != getattr(type(self), key):
                    raise ValueError(
                        f"{key} are those of encoder = 'residual', and this is {self.encoder!r}"
                    )

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """See `EncoderDecoderConfig`."""
        return {
            **super().counts(),
            "stem layers": (len(self.stem_channels), 2, 2),
            **{f"encoder_widths {each}": (each, 1, MAX_CHANNELS) for each in self.encoder_widths},
            "semantic_refine_channels": (self.semantic_refine_channels, 0, MAX_CHANNELS),
            "depth_refine_channels": (self.depth_refine_channels, 0, MAX_CHANNELS),
        }

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        return 3 if self.encoder == "efficientnet-lite0" else len(self.encoder_channels) - 1

    @property
    def target_depth_m(self) -> float:
        """See `NetworkConfig`."""
        return min(self.regressed_depth_m or self.max_depth_m, self.max_depth_m)


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

SSDNET_LITE = SSDNetLiteConfig(
    encoder="efficientnet-lite0",
    encoder_widths=(32, 48, 80, 80, 160, 160, *[320] * 3, *[480] * 3, *[896] * 3, 640),
    additive_refinement=True,
)

SSDNET_NANO = replace(
    SSDNET_LITE,
    name="ssdnet-nano",
    encoder_widths=(16, 24, 32, 32, 72, 72, *[144] * 3, *[208] * 3, *[352] * 4),
    decoder_channels=(32, 16, 16),
    semantic_refine_channels=0,
    depth_refine_channels=0,
    additive_refinement=False,
)
