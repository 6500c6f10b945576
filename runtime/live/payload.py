"""Checks of what a LiDAR pushes, a depth map or a scan, before its image is known."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.preprocess import check_sparse_depth


class Points(NamedTuple):
    """A scan, to be projected into its image."""

    points: NDArray[np.float32]

    def copy(self) -> "Points":
        """A copy with an array of its own."""
        return Points(self.points.copy())


def check_depth(sparse_depth: Any) -> NDArray[np.float32]:
    """Return a depth map of any size, contiguous; raises InputError."""
    if isinstance(sparse_depth, np.ndarray) and sparse_depth.ndim == 2:
        size = sparse_depth.shape
    else:
        size = (0, 0)  # which no array has
    return check_sparse_depth(sparse_depth, size=size)


def check_points(points: Any, *, calibration: Calibration | None) -> Points:
    """Check a scan and that it can be projected; raises InputError."""
    if calibration is None:
        raise InputError("push_points needs a calibration: make the stream with calibration=")
    calibration.check(points)
    return Points(points)
