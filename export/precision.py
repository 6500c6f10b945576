"""The precision of a file's trunk, and what 8-bit integers need."""

from enum import StrEnum

# Least numbers of frames of --calibrate and of --validate for int8: to export at all, and to do
# it without a warning.
LEAST_FRAMES, ENOUGH_FRAMES = 30, 100
# Largest fall of the mIoU [points] and largest rise of the depth's MAE [%] of a set by int8.
MAX_DROP_MIOU, MAX_RISE_MAE = 0.5, 2.0


class Precision(StrEnum):
    """Precision of a file's trunk."""

    FP32 = "fp32"
    FP16 = "fp16"
    INT8 = "int8"
