"""The precision of a file's trunk."""

from dataclasses import dataclass
from enum import StrEnum

# Least numbers of frames of --calibrate and of --validate for int8: to export at all, and to do
# it without a warning.
LEAST_FRAMES, ENOUGH_FRAMES = 30, 100


class Precision(StrEnum):
    """Floating-point precision; for 8-bit integers see `Int8Options`."""

    FP32 = "fp32"
    FP16 = "fp16"


@dataclass(frozen=True)
class Int8Options:
    """What quantisation needs, and the gate that its file must pass.

    Attributes:
        calibrate: data sets on which the ranges are measured, as `ssdnet-eval` takes them,
            KIND:FOLDER[,KEY=VALUE...].
        max_drop_miou: largest fall of the mIoU of a set, in points.
        max_rise_mae: largest rise of the MAE of the depth of a set, in percent.
    """

    calibrate: tuple[str, ...]
    max_drop_miou: float = 0.5
    max_rise_mae: float = 2.0
