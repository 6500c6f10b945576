"""What a single image shows of its camera: blur, darkness, saturation.

The limits were chosen on 1068 day-time pictures of eleven recordings, none of which is beyond one,
on a motorway by night, which is dark, and on pictures that were blurred, darkened and brightened.
"""

import cv2
import numpy as np

from runtime.base.arrays import UInt8
from runtime.contract.degraded import IMAGE_BLURRED, IMAGE_CONSTANT, IMAGE_DARK, IMAGE_OVEREXPOSED

_CONSTANT_STEP = 16  # every 16th pixel usually rules out a constant image
_ROWS = 48  # at least so many rows are measured, if there are
_COLUMN_STEP = 8  # brightness is measured in every 8th column of them
_EDGE_PX = 8  # a sharp edge is nearly as high between neighbours as over so many pixels
_BRIGHT, _SATURATED = 150, 250  # of 255
# Least sharpness, least share of bright pixels, and share of saturated ones that is too large. By
# day the pictures have 0.34 and more, 0.078 and more, and up to 0.44. Blurred by 2 pixels and more
# they have up to 0.25, and by night up to 0.006 of the pixels are bright.
_SHARP, _BRIGHT_SHARE, _SATURATED_SHARE = 0.27, 0.02, 0.5


def find_doubts(rgb: UInt8) -> tuple[str, ...]:
    """Return the reasons of `Prediction.degraded` that an image, uint8 (H, W, 3), gives."""
    return (IMAGE_CONSTANT,) if is_constant(rgb) else find_measured_doubts(rgb)


def find_measured_doubts(rgb: UInt8) -> tuple[str, ...]:
    """Return the reasons that follow from the measures of an image, also of a constant one.

    The sharpness is the steepest step between neighbours in a row over the highest step within
    eight pixels, over all rows that are measured: 1 is sharp, and 1/8 is a ramp.
    """
    rows = np.ascontiguousarray(rgb[:: max(1, rgb.shape[0] // _ROWS)])
    middle = np.ascontiguousarray(rows[..., 1])
    steps, edges = (_highest_steps(middle, apart) for apart in (1, _EDGE_PX))
    red, green, blue = np.moveaxis(rows[:, ::_COLUMN_STEP], 2, 0)
    bright = np.maximum(np.maximum(red, green), blue) >= _BRIGHT
    saturated = np.minimum(np.minimum(red, green), blue) >= _SATURATED
    found = {
        IMAGE_BLURRED: edges > 0 and steps / edges < _SHARP,
        IMAGE_DARK: bright.mean() < _BRIGHT_SHARE,
        IMAGE_OVEREXPOSED: saturated.mean() >= _SATURATED_SHARE,
    }
    return tuple(reason for reason, holds in found.items() if holds)


def is_constant(rgb: UInt8) -> bool:
    """Whether all pixels of `rgb`, uint8 (H, W, 3), have the same colour."""
    first = rgb[0, 0]
    if (rgb[::_CONSTANT_STEP, ::_CONSTANT_STEP] != first).any():
        return False
    return bool((rgb == first).all())


def _highest_steps(rows: UInt8, apart: int) -> float:
    """Return the sum over the rows of the largest difference of pixels `apart` columns."""
    steps = cv2.absdiff(rows[:, apart:], rows[:, :-apart])
    return float(steps.max(axis=1).sum(dtype=np.float64))
