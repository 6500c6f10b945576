"""Move the returns of a LiDAR on a moving car to one time."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.sync.poses import PoseFrame, PoseTrack, check_pose

#: Poses are computed at so many times of a scan; between them, in 1.6 ms of 100, matrices are
#: linear: off by 0.01 mm at 100 m in a turn of 0.5 rad/s.
_KNOTS = 65
#: Steps of the time grid to which times of points are rounded: 24 µs of 100 ms, 1 mm at 40 m/s.
_STEPS = 64


def move_points(
    points: NDArray[np.float32],
    times: NDArray[np.int64] | int,
    poses: PoseTrack,
    to: int,
) -> NDArray[np.float32]:
    """Move each return from where the LiDAR was at its own time to where it is at another one.

    What stands still in the world is then where the LiDAR would have measured it at `to`.

    Args:
        points: float32 (N, 3) or wider, x, y, z first, metres, in the LiDAR's frame.
        times: int64 (N,), nanoseconds, when each was measured; or one time for all.
        poses: of the LiDAR, by the same clock.
        to: nanoseconds, the time to move to, as that of a picture.

    Returns:
        float32 as `points`, a new array; the other columns as they are.

    Raises:
        NoPoseError: if there is no pose for one of the times.
        InputError: for arrays of another type or shape.
    """
    _check_points(points)
    xyz = np.ascontiguousarray(points[:, :3].T)
    moved = points.copy()
    if isinstance(times, np.ndarray) and times.ndim:
        _check_times(times, len(points))
        if len(points):
            _move(xyz, times, _table(times, poses, to), moved)
    else:
        (matrix,) = relative_poses(poses, np.array([times], np.int64), to)
        table = _Table(matrix[:3].reshape(12, 1).astype(np.float32), int(times), 0.0)
        _move(xyz, None, table, moved)
    return moved


class _Table(NamedTuple):
    """The 12 entries of matrices to one time, float32 (12, M), at even steps from `first_ns` on."""

    entries: NDArray[np.float32]
    first_ns: int
    steps_a_ns: float


def _check_points(points: Any) -> None:
    if not isinstance(points, np.ndarray) or points.dtype != np.float32 or points.ndim != 2:
        got = getattr(points, "dtype", type(points).__name__)
        raise InputError(f"points must be float32 (N, 3) or wider, got {got}")
    if points.shape[1] < 3:
        raise InputError(f"points must have the shape (N, 3) or wider, got {points.shape}")


def _check_times(times: NDArray[Any], count: int) -> None:
    if times.dtype != np.int64 or times.shape != (count,):
        raise InputError(
            f"times must be int64 ({count},), nanoseconds, got {times.dtype} {times.shape}"
        )


def _move(
    xyz: NDArray[np.float32],
    times: NDArray[np.int64] | None,
    table: _Table,
    moved: NDArray[np.float32],
) -> None:
    """Move points, float32 (3, N), into (N, 3): each by its time's matrix; None = all by the first.

    Columns after the third are left as they are.
    """
    index: Any = None
    if times is not None:
        place = (times - table.first_ns).astype(np.float32)
        place *= np.float32(table.steps_a_ns)
        place += np.float32(0.5)
        index = place.astype(np.intp)
    total, factor = np.empty_like(xyz[0]), np.empty_like(xyz[0])
    with np.errstate(over="ignore", invalid="ignore"):  # returns that are not finite stay so
        for row in range(3):
            for column, axis in enumerate((None, *xyz)):
                entry = table.entries[4 * row + (column - 1) % 4]
                into = total if axis is None else factor
                if index is None:
                    into[:] = entry[0]
                else:
                    entry.take(index, out=into, mode="clip")
                if axis is not None:
                    factor *= axis
                    total += factor
            moved[:, row] = total


def _table(times: NDArray[np.int64], poses: PoseTrack, to_ns: int) -> _Table:
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


def _in_front(
    xyz: NDArray[np.float32], table: _Table, extrinsics: NDArray[np.float64]
) -> NDArray[np.intp]:
    """A superset of the points that any of the matrices moves in front of the camera."""
    moves = table.entries[:, ::_STEPS].T.reshape(-1, 3, 4).astype(np.float64)
    ahead = extrinsics[2, :3] @ moves
    middle = ahead.mean(axis=0)
    spread = np.abs(ahead - middle).max(axis=0)
    farthest = max(float(np.fmax.reduce(xyz, axis=None)), -float(np.fmin.reduce(xyz, axis=None)))
    nearest = -(middle[3] + extrinsics[2, 3]) - spread[3] - 1e-3
    with np.errstate(over="ignore", invalid="ignore"):
        nearest -= (spread[:3].sum() + 1e-6) * farthest
        depth, factor = xyz[0] * np.float32(middle[0]), np.empty_like(xyz[0])
        for axis, along in zip(xyz[1:], middle[1:3], strict=True):
            np.multiply(axis, np.float32(along), out=factor)
            depth += factor
        if not np.isfinite(nearest):  # a return is not finite: keep all points
            return np.arange(len(depth))
        return np.flatnonzero(depth >= np.float32(nearest))


def project_moved(
    calibration: Calibration,
    points: NDArray[np.float32],
    times: NDArray[np.int64] | int,
    poses: PoseTrack,
    to: int,
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """Project a scan into a picture of the time `to`, see `move_points` and `project_points`.

    Args:
        calibration: of camera and LiDAR.
        points: see `move_points`.
        times: see `move_points`.
        poses: see `move_points`.
        to: nanoseconds, the time of the picture.
        size: its (height, width).

    Returns:
        float32 (height, width), metres along the optical axis, 0 where there is no return.

    Raises:
        NoPoseError: if there is no pose for one of the times.
        InputError: if the size is not the calibration's, and for invalid arrays.
    """
    calibration.require_size(size)
    extrinsics = calibration.extrinsics
    if isinstance(times, np.ndarray):
        _check_points(points)
        _check_times(times, len(points))
        if len(points):
            table, xyz = _table(times, poses, to), np.ascontiguousarray(points[:, :3].T)
            rows = _in_front(xyz, table, extrinsics)
            points = np.empty((3, len(rows)), np.float32).T  # read fastest by the projection
            _move(xyz.take(rows, axis=1), times.take(rows), table, points)
    else:
        (moved,) = relative_poses(poses, np.array([times], np.int64), to)
        extrinsics = extrinsics @ moved
    return replace(calibration, extrinsics=extrinsics).project(points, size)


def lidar_mount(pose_frame: PoseFrame, calibration: Calibration) -> NDArray[np.float64]:
    """Return the matrix float64 (4, 4) from the LiDAR to the frame of which poses are given.

    Raises:
        InputError: if the calibration does not have it, or it is not rigid.
    """
    if pose_frame is PoseFrame.LIDAR:
        return np.eye(4)
    if pose_frame is PoseFrame.CAMERA:
        return check_pose(calibration.extrinsics, "extrinsics")
    if calibration.body_from_lidar is None:
        raise InputError(
            'poses of the "body" need body_from_lidar, 4 x 4, in the calibration: add it to its '
            'TOML, or give poses of the "lidar" or the "camera"'
        )
    return check_pose(calibration.body_from_lidar, "body_from_lidar")


def relative_poses(
    poses: PoseTrack, times_ns: NDArray[np.int64], to_ns: int
) -> NDArray[np.float64]:
    """Matrices float64 (M, 4, 4) from the frame at each of the times to the frame at `to_ns`.

    Raises:
        NoPoseError: if there is no pose for one of the times.
    """
    all_poses = poses.at(np.append(times_ns, np.int64(to_ns)))
    # Subtracted before the rotation: positions may be far from the origin.
    to, others = all_poses[-1], all_poses[:-1]
    matrices = np.zeros_like(others)
    matrices[:, :3, :3] = to[:3, :3].T @ others[:, :3, :3]
    matrices[:, :3, 3] = (others[:, :3, 3] - to[:3, 3]) @ to[:3, :3]
    matrices[:, 3, 3] = 1
    return matrices
