"""Motion compensation: the returns of a scan are moved to the time of an image."""

from typing import Any, Literal, NamedTuple, cast

import numpy as np

from runtime.base.arguments import shown
from runtime.base.arrays import Bools, Float32, Float64, Indices, Int64, Size
from runtime.base.errors import InputError
from runtime.base.stamp import NS_PER_MS
from runtime.geometry.assumptions import assume
from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import PoseFrame, PoseTrack, check_pose_frame
from runtime.geometry.projection import project_points
from runtime.geometry.returns import check_points, coordinates_of, is_return

DepthMotion = Literal["each", "scan", "none"]
# The instant of a scan that its stamp marks.
ScanStamp = Literal["start", "middle", "end"]
# Time from the stamp to the middle of the scan, in scan durations, for each instant of the stamp.
MIDDLE_AFTER: dict[ScanStamp, float] = {"start": 0.5, "middle": 0.0, "end": -0.5}
# Duration of a scan until the LiDAR's period is known: the period at 10 Hz.
FIRST_SCAN_NS = 100 * NS_PER_MS
_LONGEST_SCAN_S = 1.0
# Number of times of a scan at which its pose is computed. Between two of them, which are 1.6 ms
# apart in a scan of 100 ms, matrices are interpolated linearly. The error is 0.01 mm at 100 m in a
# turn of 0.5 rad/s.
_KNOTS = 65
# Steps between two of these times. The time of a point is rounded to a step, which is 24 µs in a
# scan of 100 ms; a car of 40 m/s drives 1 mm in a step.
_STEPS = 64


def find_returns(points: Any, after_s: Float64 | None) -> tuple[Bools, bool]:
    """Return which points of a scan are kept, bool (N,), and whether times left out returns.

    See `Scan.of`, which also has the arguments and errors.
    """
    check_points(points)
    returns = is_return(points)
    if after_s is None:
        return returns, False
    kept = returns & (np.abs(after_s) <= _LONGEST_SCAN_S)  # false for NaN
    if 2 * np.count_nonzero(kept) < np.count_nonzero(returns):
        raise InputError(
            f"times must be within {_LONGEST_SCAN_S:g} s of the stamp, got "
            f"{np.median(np.abs(after_s)):g} s: are they of another unit or clock?"
        )
    _check_clock(after_s[kept])
    return kept, bool((kept != returns).any())


def _check_clock(after_s: Float64) -> None:
    """Warn if the times of points, in seconds after their scan's stamp, are far from the stamp.

    A stamp lies between the start and the end of its scan, or at most one scan duration from it.
    """
    if not after_s.size:
        return
    first, last = np.percentile(after_s[:: after_s.size // 1000 + 1], (5, 95))
    apart_s = max(first, -last)
    if apart_s > max(last - first, FIRST_SCAN_NS / 1e9):
        assume(
            "the stamp of a scan is of another clock than the times of its points, which are right",
            f"they are {apart_s:.2g} s apart, where a scan has its points at its stamp: let the "
            "driver stamp both by one clock, or read the scans without times or poses",
        )


def assume_middle() -> None:
    """Warn that the stamp of a scan whose points have no times is assumed to mark its middle."""
    assume("the stamps of scans mark their middle", "`scan_stamp=` states which")


def check_scan_stamp(value: Any) -> ScanStamp:
    """Return the instant of a scan that its stamp marks. Raises InputError for another word."""
    if value not in MIDDLE_AFTER:
        raise InputError(f"scan_stamp must be one of {', '.join(MIDDLE_AFTER)}, got {shown(value)}")
    return cast(ScanStamp, value)


def point_times(times: Any, count: int, stamp_ns: int) -> Float64:
    """Return when the points of a scan were measured, float64 (N,), in seconds after the stamp.

    Args:
        times: (N,), seconds after the stamp as floats, or nanoseconds of the stamp's clock as
            integers.
        count: N.
        stamp_ns: time stamp of the scan.

    Raises:
        InputError: if the type or shape is another one.
    """
    kind = times.dtype.kind if isinstance(times, np.ndarray) else None
    if kind not in ("f", "i", "u") or times.shape != (count,):
        got = f"{times.dtype} {times.shape}" if kind else type(times).__name__
        raise InputError(
            f"times must have the shape ({count},), seconds after the stamp as floats or "
            f"nanoseconds of its clock as integers, got {got}"
        )
    if kind == "f":
        return np.asarray(times, np.float64)
    return np.asarray((times.astype(np.int64) - stamp_ns) / 1e9)


def compensate_points(points: Float32, times: Int64 | int, poses: PoseTrack, to: int) -> Float32:
    """Move each return from where the LiDAR was at its own time to where it is at another time.

    An object that stands still is then where the LiDAR would have measured it at the time `to`.

    Args:
        points: float32 (N, 3) or wider, x, y, z first, metres, in the LiDAR's frame.
        times: int64 (N,), nanoseconds, when each point was measured; or one time for all.
        poses: poses of the LiDAR, by the same clock.
        to: the time to move to, such as that of an image, in nanoseconds.

    Returns:
        A new array, float32, of the shape of `points`. Columns after the third are unchanged. NaN
        where a point is no return, see `is_return`.

    Raises:
        NoPoseError: if there is no pose for one of the times.
        InputError: if an array has another type or shape, or the points cannot be metres.
    """
    check_points(points)
    moved = points.copy()
    if len(points):
        times_ns = np.broadcast_to(np.int64(times), len(points))
        _move(coordinates_of(points), times_ns, _table(times_ns, poses, to), moved)
    return moved


def project_compensated(
    calibration: Calibration,
    points: Float32,
    times: Int64 | int,
    poses: PoseTrack,
    to: int,
    size: Size,
) -> Float32:
    """Project a scan into an image of the time `to`, see `compensate_points` and `project_points`.

    Args:
        calibration: calibration of camera and LiDAR.
        points: see `compensate_points`.
        times: see `compensate_points`.
        poses: see `compensate_points`.
        to: time of the image in nanoseconds.
        size: (height, width) of the image.

    Returns:
        float32 (height, width), metres along the optical axis, 0 where there is no return.

    Raises:
        NoPoseError: if there is no pose for one of the times.
        InputError: if the size is not the calibration's, or an array is invalid.
    """
    check_points(points)
    calibration.require_size(size)
    extrinsics = calibration.extrinsics
    if isinstance(times, int):
        (moved,) = relative_poses(poses, np.array([times], np.int64), to)
        extrinsics = extrinsics @ moved
    elif len(points):
        table, xyz = _table(times, poses, to), coordinates_of(points)
        rows = _in_front(xyz, table, extrinsics)
        points = np.empty((3, len(rows)), np.float32).T  # read fastest by the projection
        _move(xyz.take(rows, axis=1), times.take(rows), table, points)
    # The transform holds the car's motion, too, which a calibration would take for the mount.
    return project_points(
        points, calibration.intrinsics, extrinsics, size, lens=calibration.lens_model
    )


class _Table(NamedTuple):
    """The 12 entries of matrices to one time, float32 (12, M), in even steps from `first_ns`."""

    entries: Float32
    first_ns: int
    steps_a_ns: float


def _table(times: Int64, poses: PoseTrack, to_ns: int) -> _Table:
    """The matrices for the times of a scan. Raises NoPoseError."""
    first_ns, last_ns = int(times.min()), int(times.max())
    poses.at(np.array([first_ns, last_ns], np.int64))  # raises NoPoseError early
    knots_ns = np.linspace(0, last_ns - first_ns, _KNOTS).round().astype(np.int64) + first_ns
    knots = relative_poses(poses, knots_ns, to_ns)[:, :3].reshape(_KNOTS, 12).T
    entries = np.empty((12, (_KNOTS - 1) * _STEPS + 1), np.float32)
    share = np.arange(_STEPS) / _STEPS
    between = knots[:, :-1, None] + np.diff(knots)[:, :, None] * share
    entries[:, :-1] = between.reshape(12, -1)
    entries[:, -1] = knots[:, -1]
    return _Table(entries, first_ns, (entries.shape[1] - 1) / max(last_ns - first_ns, 1))


def _move(xyz: Float32, times: Int64, table: _Table, moved: Float32) -> None:
    """Move points, float32 (3, N), into the first columns of (N, 3), each by its time's matrix."""
    place = (times - table.first_ns).astype(np.float32)
    place *= np.float32(table.steps_a_ns)
    place += np.float32(0.5)
    index = place.astype(np.intp)
    total, factor = np.empty_like(xyz[0]), np.empty_like(xyz[0])
    with np.errstate(invalid="ignore"):  # NaN remains NaN
        for row in range(3):
            *of_axes, shift = table.entries[4 * row : 4 * row + 4]
            shift.take(index, out=total, mode="clip")
            for entry, axis in zip(of_axes, xyz, strict=True):
                entry.take(index, out=factor, mode="clip")
                factor *= axis
                total += factor
            moved[:, row] = total


def _in_front(xyz: Float32, table: _Table, extrinsics: Float64) -> Indices:
    """A superset of the points that any of the matrices moves in front of the camera."""
    moves = table.entries[:, ::_STEPS].T.reshape(-1, 3, 4).astype(np.float64)
    ahead = extrinsics[2, :3] @ moves
    middle = ahead.mean(axis=0)
    spread = np.abs(ahead - middle).max(axis=0)
    farthest = max(float(np.fmax.reduce(xyz, axis=None)), -float(np.fmin.reduce(xyz, axis=None)))
    nearest = -(middle[3] + extrinsics[2, 3]) - spread[3] - 1e-3
    nearest -= (spread[:3].sum() + 1e-6) * farthest
    depth, factor = xyz[0] * np.float32(middle[0]), np.empty_like(xyz[0])
    for axis, along in zip(xyz[1:], middle[1:3], strict=True):
        np.multiply(axis, np.float32(along), out=factor)
        depth += factor
    return np.flatnonzero(depth >= np.float32(nearest))  # false for NaN


def lidar_mount(pose_frame: PoseFrame | str, calibration: Calibration) -> Float64:
    """Return the matrix, float64 (4, 4), from the LiDAR to the frame whose poses are given.

    Raises:
        InputError: if the frame is unknown, or if the calibration does not contain it.
    """
    frame = check_pose_frame(pose_frame)
    if frame is PoseFrame.LIDAR:
        return np.eye(4)
    if frame is PoseFrame.CAMERA:
        return calibration.extrinsics
    if calibration.body_from_lidar is None:
        raise InputError(
            'poses of the "body" need body_from_lidar, 4 x 4, in the calibration: add it to its '
            'TOML, or give poses of the "lidar" or the "camera"'
        )
    return calibration.body_from_lidar


def relative_poses(poses: PoseTrack, times_ns: Int64, to_ns: int) -> Float64:
    """Return matrices from the frame at each of the times to the frame at `to_ns`.

    Returns:
        float64 (M, 4, 4).

    Raises:
        NoPoseError: if there is no pose for one of the times.
    """
    all_poses = poses.at(np.append(times_ns, np.int64(to_ns)))
    # The subtraction comes before the rotation, because positions may be far from the origin.
    to, others = all_poses[-1], all_poses[:-1]
    matrices = np.zeros_like(others)
    matrices[:, :3, :3] = to[:3, :3].T @ others[:, :3, :3]
    matrices[:, :3, 3] = (others[:, :3, 3] - to[:3, 3]) @ to[:3, :3]
    matrices[:, 3, 3] = 1
    return matrices
