"""The configuration of the SSDNet family, and its named members."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from models.network import NetworkConfig
from models.surfaces import COARSE_CELL
from runtime.contract import check_max_depth

# Limits, far beyond any network in use.
MAX_STAGES = 8
MAX_BLOCKS = 100
MAX_CHANNELS = 8192


@dataclass(frozen=True)
class SSDNetConfig(NetworkConfig):
    """The configuration of a network of the family: heads, inputs, channels.

    The defaults are the paper's full network (SSDNet, Sensors 2020) with the channel list that
    reproduces its printed parameters and multiply-accumulates.

    Raises:
        ValueError: if a value is outside its range, or a combination cannot be built.
    """

    name: str = "ssdnet"

    semantic_head: bool = True
    depth_head: bool = True
    use_rgb: bool = True
    use_sparse_depth: bool = True

    #: Channels of 3x3 stride-2 convolutions in front of the first scale; () starts at full size.
    stem_channels: tuple[int, ...] = ()
    #: Channels and blocks of each encoder stage, fine to coarse.
    encoder_channels: tuple[int, ...] = (64, 128, 256, 512, 512)
    encoder_blocks: tuple[int, ...] = (2, 2, 3, 3, 3)
    #: "plain": VGG's conv-BN-ReLU, each stage a skip, max-pool after each.
    #: "residual": two-conv residual blocks, strided between stages, the last stage is the bottom.
    encoder_block: Literal["plain", "residual"] = "plain"
    #: Channels of the UpBlocks, coarse to fine: one for each skip.
    decoder_channels: tuple[int, ...] = (512, 192, 96, 64, 16)
    #: How a decoder joins a skip: the paper's concatenation, or a 1x1 projection added.
    skip_fusion: Literal["concat", "add"] = "concat"
    #: Channels of one more UpBlock of the semantic decoder, on the grid of the stem's first
    #: convolution; 0 = none. Poles and signs are thinner than a cell of the coarser grid.
    semantic_refine_channels: int = 0
    #: Add the candidate surfaces around each pixel to the input, choose among them in the depth
    #: head, and predict the depth's uncertainty, see `models.surfaces`.
    depth_surfaces: bool = False
    #: Channels of one more UpBlock of the depth decoder, on the same grid, for that choice; 0 =
    #: none, the choice is made on the grid of the stem.
    depth_refine_channels: int = 0
    #: Depth [m] that the regression reaches at most, without the surfaces that returns show; None =
    #: `max_depth_m`.
    regressed_depth_m: float | None = None
    boundary_channels: int = 16
    #: Gate the decoders by 1 - B (Eq. 1); without it B = 0 and a BaConv is a plain convolution.
    boundary_gating: bool = True
    #: Factor on the normalised sparse depth at the input. At 5 % of the pixels its mean is a
    #: twentieth of that of the normalised colours, and the network learns to use it late.
    sparse_depth_gain: float = 1.0
    #: Add the mask of measured pixels to the input.
    valid_mask_input: bool = False
    #: Add the projected global mean of the bottom features to them.
    global_context: bool = False

    def __post_init__(self) -> None:
        """Check the values and their combinations."""
        if not (self.semantic_head or self.depth_head):
            raise ValueError("a network needs a semantic head, a depth head or both")
        if not (self.use_rgb or self.use_sparse_depth):
            raise ValueError("a network needs rgb, sparse depth or both as input")
        self._check_sizes()
        super().__post_init__()
        if len(self.encoder_channels) != len(self.encoder_blocks):
            raise ValueError("encoder_channels and encoder_blocks must have the same length")
        if len(self.decoder_channels) != self.num_skips:
            raise ValueError(
                f"decoder_channels needs a number for each of the {self.num_skips} skips, "
                f"got {len(self.decoder_channels)}"
            )
        if self.semantic_refine_channels and not (
            self.semantic_head and len(self.stem_channels) > 1
        ):
            raise ValueError("semantic_refine_channels needs a semantic head and two stem layers")
        if self.depth_refine_channels and not self.depth_surfaces:
            raise ValueError("depth_refine_channels needs depth_surfaces")
        if self.depth_surfaces and not (self.depth_head and self.use_sparse_depth):
            raise ValueError("depth_surfaces needs the sparse depth and a depth head")
        if self.depth_surfaces and not self.valid_mask_input:
            raise ValueError("depth_surfaces needs valid_mask_input")
        if self.depth_surfaces and self.sparse_depth_gain != 1:
            raise ValueError(
                "depth_surfaces needs the unscaled sparse depth: sparse_depth_gain = 1"
            )
        if not self.sparse_depth_gain > 0:
            raise ValueError(f"sparse_depth_gain must be positive, got {self.sparse_depth_gain}")
        if self.regressed_depth_m is not None:
            check_max_depth(self.regressed_depth_m, "regressed_depth_m")
        if self.depth_surfaces and self.output_stride != COARSE_CELL:
            raise ValueError(f"depth_surfaces needs a stem of stride {COARSE_CELL}")

    def _check_sizes(self) -> None:
        """Check the numbers of layers and channels before they are allocated."""
        counts = {
            "stem layers": (len(self.stem_channels), 0, MAX_STAGES),
            "encoder stages": (len(self.encoder_channels), 1, MAX_STAGES),
            "blocks of a stage": (max(self.encoder_blocks, default=1), 1, MAX_BLOCKS),
        }
        for key in ("stem_channels", "encoder_channels", "decoder_channels"):
            for channels in getattr(self, key):
                counts[f"{key} {channels}"] = (channels, 1, MAX_CHANNELS)
        counts["boundary_channels"] = (self.boundary_channels, 1, MAX_CHANNELS)
        for key in ("semantic_refine_channels", "depth_refine_channels"):
            counts[key] = (getattr(self, key), 0, MAX_CHANNELS)
        for what, (count, least, most) in counts.items():
            if not least <= count <= most:
                raise ValueError(f"{what}: {least} to {most} can be built, got {count}")

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        stages = len(self.encoder_channels)
        return stages if self.encoder_block == "plain" else stages - 1

    @property
    def target_depth_m(self) -> float:
        """See `NetworkConfig`."""
        return min(self.regressed_depth_m or self.max_depth_m, self.max_depth_m)

    @property
    def output_stride(self) -> int:
        """Ratio of the image to the finest grid of depth and boundaries."""
        return int(2 ** len(self.stem_channels))


SSDNET = SSDNetConfig()

#: The same structure at a fortieth of the parameters, for experiments on a CPU: a strided stem
#: instead of the first stage at full size, and narrower.
SSDNET_SMALL = SSDNetConfig(
    name="ssdnet-small",
    stem_channels=(16,),
    encoder_channels=(32, 48, 64, 96),
    encoder_blocks=(1, 2, 2, 2),
    decoder_channels=(64, 48, 32, 16),
)

SSDNET_LITE = SSDNetConfig(
    name="ssdnet-lite",
    stem_channels=(16, 32),
    encoder_channels=(32, 64, 128, 256),
    encoder_blocks=(1, 2, 2, 2),
    encoder_block="residual",
    decoder_channels=(64, 48, 32),
    skip_fusion="add",
    semantic_refine_channels=16,
    valid_mask_input=True,
    depth_surfaces=True,
    depth_refine_channels=16,
    global_context=True,
    max_depth_m=200.0,
    regressed_depth_m=100.0,
)

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


_DEPTH_ALONE: dict[str, Any] = {"semantic_head": False, "classes": ()}


def _with_ablations(config: SSDNetConfig) -> tuple[SSDNetConfig, ...]:
    """Return a network and the rows of the paper's ablation; SSDNet_ind differs only in losses."""

    def variant(suffix: str, **changes: Any) -> SSDNetConfig:
        return replace(config, name=f"{config.name}-{suffix}", **changes)

    return (
        config,
        variant("sem", depth_head=False),
        variant("dep", **_DEPTH_ALONE),
        variant("dep-d", **_DEPTH_ALONE, use_rgb=False),
        variant("dep-rgb", **_DEPTH_ALONE, use_sparse_depth=False),
    )


#: The named networks of the family.
FAMILY: tuple[SSDNetConfig, ...] = (
    *_with_ablations(SSDNET),
    *_with_ablations(SSDNET_SMALL),
    SSDNET_LITE,
    SSDNET_NANO,
)
