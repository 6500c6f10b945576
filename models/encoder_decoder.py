"""What the configurations of `SSDNet` and `SSDNetLite` have in common."""

from dataclasses import dataclass

from models.network import NetworkConfig

# Limits, far beyond any network in use.
MAX_STAGES = 8
MAX_BLOCKS = 100
MAX_CHANNELS = 8192


@dataclass(frozen=True)
class EncoderDecoderConfig(NetworkConfig):
    """One encoder, a boundary decoder and two task decoders.

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
                raise ValueError(f"{what}: {least} to {most} can be built, got {count}")
        super().__post_init__()
        if len(self.encoder_channels) != len(self.encoder_blocks):
            raise ValueError("encoder_channels and encoder_blocks must have the same length")
        if len(self.decoder_channels) != self.num_skips:
            raise ValueError(
                f"decoder_channels needs a number for each of the {self.num_skips} skips, "
                f"got {len(self.decoder_channels)}"
            )

    @property
    def num_skips(self) -> int:
        """Number of encoder features that the decoders get."""
        raise NotImplementedError

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
