"""Checks of what a LiDAR sends, a depth map or a scan, before its image is known."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.preprocess import check_sparse_depth
from runtime.sync.depth_in_time import point_times


class Points(NamedTuple):
    """A scan, to be projected into its image.

    Attributes:
        points: float32 (N, 3) or wider, metres, LiDAR frame.
        times: nanoseconds: int64 (N,), one time for all, or None = not known yet.
        first_ns, last_ns: of the times.
    """

    points: NDArray[np.float32]
    times: NDArray[np.int64] | int | None = None
    first_ns: int = 0
    last_ns: int = 0

    def copy(self) -> "Points":
        """Return a copy that owns its array."""
        return self._replace(points=self.points.copy())

    def measured_at(self, time_ns: int) -> "Points":
        """The scan with this time for all points, unless they have times of their own."""
        if self.times is not None:
            return self
        return self._replace(times=time_ns, first_ns=time_ns, last_ns=time_ns)


def check_depth(sparse_depth: Any) -> NDArray[np.float32]:
    """Return a depth map of any size, contiguous; raises InputError."""
    is_map = isinstance(sparse_depth, np.ndarray) and sparse_depth.ndim == 2
    # No array that gets there has the size (0, 0).
    return check_sparse_depth(sparse_depth, size=sparse_depth.shape if is_map else (0, 0))


def check_points(
    points: Any, *, times: Any, stamp_ns: int, calibration: Calibration | None
) -> Points:
    """Check a scan and that it can be projected; raises InputError."""
    if calibration is None:
        raise InputError("points need a calibration to be projected: give calibration=")
    calibration.check(points)
    if times is None:
        return Points(points)
    return Points(points, *point_times(times, len(points), stamp_ns))
