"""The camera's matrix that a frame's cloud is made with."""

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.sources.frames import Frame


def intrinsics_of(frame: Frame, focal_length_px: float | None) -> NDArray[np.float64]:
    """Return the camera's 3 x 3 matrix in pixels of the frame.

    It is that of the frame's calibration; of a frame without, the pinhole of the focal length whose
    axis goes through the middle of the picture. Raises InputError where neither is known.
    """
    if frame.calibration is not None:
        return frame.calibration.intrinsics
    if focal_length_px is None:
        raise InputError(
            "where the points of a cloud lie is a matter of the camera: give --calibration, or "
            "--focal-length"
        )
    height, width = frame.rgb.shape[:2]
    return np.array(
        [
            [focal_length_px, 0, (width - 1) / 2],
            [0, focal_length_px, (height - 1) / 2],
            [0, 0, 1],
        ]
    )
