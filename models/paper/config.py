"""The configurations of `SSDNet` and its named members."""

from dataclasses import dataclass, replace
from typing import Any

from models.network import NetworkConfig, check_counts

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
