"""The depth of a picture: its returns at the picture's time, or what is wrong with them."""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.prediction import DEPTH_REUSED, DEPTH_UNCOMPENSATED
from runtime.sync.motion import project_moved
from runtime.sync.poses import NoPoseError, PoseTrack
from runtime.sync.stamp import NS_PER_MS

DepthMotion = Literal["each", "scan", "none"]
#: The instant of a scan that its stamp marks.
ScanStamp = Literal["start", "middle", "end"]
#: Instant of the stamp -> time from the stamp to the middle of the scan, in scan durations.
MIDDLE_AFTER: dict[ScanStamp, float] = {"start": 0.5, "middle": 0.0, "end": -0.5}
#: Duration of a scan until the LiDAR's period is known: that of 10 Hz.
FIRST_SCAN_NS = 100 * NS_PER_MS
_LONGEST_SCAN_NS = 1_000 * NS_PER_MS


def check_scan_stamp(value: Any) -> ScanStamp:
    """Return the instant of a scan that its stamp is; InputError for another word."""
    if value not in MIDDLE_AFTER:
        raise InputError(f"scan_stamp must be one of {', '.join(MIDDLE_AFTER)}, got {shown(value)}")
    known: ScanStamp = value
    return known


class DepthInTime(NamedTuple):
    """A sparse depth map.

    Attributes:
        sparse_depth: float32 (H, W), metres, 0 = no return.
        motion: "each" where each return was moved by its own time, "scan" where the scan was moved
            as one, "none" where it is as it was measured.
        degraded: reasons as in `Prediction.degraded`.
    """

    sparse_depth: NDArray[np.float32]
    motion: DepthMotion
    degraded: tuple[str, ...]


def project_in_time(
    calibration: Calibration,
    points: NDArray[np.float32],
    times: NDArray[np.int64] | int,
    poses: PoseTrack | None,
    to: int,
    size: tuple[int, int],
    *,
    reused: bool,
) -> DepthInTime:
    """Project a scan into a picture, as `project_moved` where there are poses.

    Args:
        calibration: of camera and LiDAR.
        points: see `move_points`.
        times: see `move_points`.
        poses: of the LiDAR; None = of a car without poses.
        to: nanoseconds, the time of the picture.
        size: its (height, width).
        reused: whether it is an older scan than the picture's own.

    Raises:
        InputError: if the size is not the calibration's, and for invalid arrays.
    """
    reasons: tuple[str, ...] = (DEPTH_REUSED,) if reused else ()
    if poses is not None:
        try:
            moved = project_moved(calibration, points, times, poses, to, size)
            return DepthInTime(moved, "scan" if isinstance(times, int) else "each", reasons)
        except NoPoseError as error:
            reasons += (DEPTH_UNCOMPENSATED, error.reason)
    elif reused:
        reasons += (DEPTH_UNCOMPENSATED,)
    return DepthInTime(calibration.project(points, size), "none", reasons)


def keep_map(
    sparse_depth: NDArray[np.float32], *, apart: bool, has_poses: bool, reused: bool
) -> DepthInTime:
    """Take a depth map, which cannot be moved.

    Args:
        sparse_depth: float32 (H, W), metres.
        apart: whether its stamp is not the picture's.
        has_poses: whether the car has poses, so that returns ought to be moved.
        reused: whether it is an older map than the picture's own.
    """
    reasons: tuple[str, ...] = (DEPTH_REUSED,) if reused else ()
    if reused or (has_poses and apart):
        reasons += (DEPTH_UNCOMPENSATED,)
    return DepthInTime(sparse_depth, "none", reasons)


def point_times(times: Any, count: int, stamp_ns: int) -> tuple[NDArray[np.int64], int, int]:
    """Return when the points of a scan were measured, with the first and the last of them [ns].

    Args:
        times: (N,), seconds after the stamp as floats, or nanoseconds of its clock as integers.
        count: N.
        stamp_ns: of the scan.

    Raises:
        InputError: for another type or shape, and for times that are more than 1 s from the stamp.
    """
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
