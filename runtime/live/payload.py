"""Checks of what a LiDAR pushes, a depth map or a scan, before its image is known."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.preprocess import check_sparse_depth
from runtime.sync.stamp import NS_PER_MS

_LONGEST_SCAN_NS = 1_000 * NS_PER_MS


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
    if isinstance(sparse_depth, np.ndarray) and sparse_depth.ndim == 2:
        size = sparse_depth.shape
    else:
        size = (0, 0)  # which no array has
    return check_sparse_depth(sparse_depth, size=size)


def check_points(
    points: Any, *, times: Any, stamp_ns: int, calibration: Calibration | None
) -> Points:
    """Check a scan and that it can be projected; raises InputError."""
    if calibration is None:
        raise InputError("push_points needs a calibration: make the stream with calibration=")
    calibration.check(points)
    if times is None:
        return Points(points)
    return Points(points, *_point_times(times, len(points), stamp_ns))


def _point_times(times: Any, count: int, stamp_ns: int) -> tuple[NDArray[np.int64], int, int]:
    """Nanoseconds of the points, the first and the last of them; raises InputError."""
    kind = times.dtype.kind if isinstance(times, np.ndarray) else None
    if kind not in ("f", "i", "u") or times.shape != (count,):
        got = f"{times.dtype} {times.shape}" if kind else type(times).__name__
        raise InputError(
            f"times must have the shape ({count},), seconds after the stamp as floats or "
            f"nanoseconds of its clock as integers, got {got}"
        )
    if not count:
        return np.zeros(0, np.int64), stamp_ns, stamp_ns
    if kind == "f":
        after_ns = times.astype(np.float64) * 1e9
    else:  # by extremes first: an unsigned time may be beyond int64
        least, most = int(times.min()) - stamp_ns, int(times.max()) - stamp_ns
        after_ns = np.array([least, most], np.float64)
    if not (np.abs(after_ns) <= _LONGEST_SCAN_NS).all():  # nor NaN
        far_s = np.abs(after_ns).max() / 1e9
        raise InputError(
            f"times must be within {_LONGEST_SCAN_NS / 1e9:g} s of the stamp, got {far_s:g} s: are "
            "they of another unit or clock?"
        )
    if kind == "f":
        absolute = stamp_ns + np.rint(after_ns).astype(np.int64)
    else:
        absolute = times.astype(np.int64)
    return absolute, int(absolute.min()), int(absolute.max())
