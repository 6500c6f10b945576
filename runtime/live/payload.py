"""What a LiDAR may push, a depth map or a scan, checked as far as it can be without its image."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.preprocess import check_sparse_depth


class Points(NamedTuple):
    """A scan that waits for its image, to be projected into it."""

    points: NDArray[np.float32]

    def copy(self) -> "Points":
        """Of its array, as of a depth map."""
        return Points(self.points.copy())


def check_depth(sparse_depth: Any) -> NDArray[np.float32]:
    """Give back a depth map, contiguous. Raises InputError for what is none, of whatever size."""
    if isinstance(sparse_depth, np.ndarray) and sparse_depth.ndim == 2:
        size = sparse_depth.shape
    else:
        size = (0, 0)  # of which no array is
    return check_sparse_depth(sparse_depth, size=size)


def check_points(points: Any, *, calibration: Calibration | None) -> Points:
    """Raise InputError for what is no scan, and where it cannot be projected."""
    if calibration is None:
        raise InputError(
            "push_points needs to know where the LiDAR is: make the stream with calibration="
        )
    calibration.check(points)
    return Points(points)
