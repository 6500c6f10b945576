"""The camera for the cloud of a frame."""

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.sources.frames import Frame


def intrinsics_of(frame: Frame, focal_length_px: float | None) -> Calibration | NDArray[np.float64]:
    """Return the calibration of a frame, else the camera matrix, (3, 3), of the focal length.

    Its principal point is in the middle of the image. Raises InputError where neither is known.
    """
    if frame.calibration is not None:
        return frame.calibration
    if focal_length_px is None:
        raise InputError(
            "a cloud needs the camera's intrinsics: give --calibration or --focal-length"
        )
    height, width = frame.rgb.shape[:2]
    intrinsics: NDArray[np.float64] = np.diag([focal_length_px, focal_length_px, 1.0])
    intrinsics[:2, 2] = (width - 1) / 2, (height - 1) / 2
    return intrinsics
