"""Move the returns of a LiDAR on a moving car to one time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.projection import project_points
from runtime.sync.poses import PoseFrame, PoseTrack, check_pose

#: Poses are computed at so many times of a scan; between them, in 0.4 ms, matrices are linear.
_KNOTS = 257
#: Steps from one to the next, to which times are rounded: 24 µs of 100 ms, 1 mm at 40 m/s.
_STEPS = 16


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
    if not isinstance(points, np.ndarray) or points.dtype != np.float32 or points.ndim != 2:
        got = getattr(points, "dtype", type(points).__name__)
        raise InputError(f"points must be float32 (N, 3) or wider, got {got}")
    if points.shape[1] < 3:
        raise InputError(f"points must have the shape (N, 3) or wider, got {points.shape}")
    if isinstance(times, np.ndarray) and times.ndim:
        if times.dtype != np.int64 or times.shape != points.shape[:1]:
            raise InputError(
                f"times must be int64 ({len(points)},), nanoseconds, got {times.dtype} "
                f"{times.shape}"
            )
        if not len(points):
            return points.copy()
        first_ns, last_ns = int(times.min()), int(times.max())
    else:
        first_ns = last_ns = int(times)
    poses.at(np.array([first_ns, last_ns], np.int64))  # an error before anything is computed
    index: Any = None
    if isinstance(times, np.ndarray) and last_ns > first_ns:
        table = _matrices(poses, first_ns, last_ns, to)
        place = (times - first_ns).astype(np.float32)
        place *= np.float32((table.shape[1] - 1) / (last_ns - first_ns))
        place += np.float32(0.5)
        index = place.astype(np.intp)
    else:
        moved_as_one = relative_poses(poses, np.array([first_ns], np.int64), to)
        table = moved_as_one[0, :3].reshape(12, 1).astype(np.float32)
    moved = points.copy()
    x, y, z = np.ascontiguousarray(points[:, :3].T)
    factor, total = np.empty_like(x), np.empty_like(x)
    with np.errstate(over="ignore", invalid="ignore"):  # returns that are not finite stay so
        for row in range(3):
            for column, axis in enumerate((None, x, y, z)):
                entry = table[4 * row + (column - 1) % 4]
                into = total if axis is None else factor
                if index is None:
                    into[:] = entry[0]
                else:
                    entry.take(index, out=into, mode="clip")
                if axis is not None:
                    factor *= axis
                    total += factor
            moved[:, row] = total
    return moved


def _matrices(poses: PoseTrack, first_ns: int, last_ns: int, to_ns: int) -> NDArray[np.float32]:
    """The 12 entries of the matrices to `to_ns` at even steps from the first to the last time."""
    knots_ns = np.linspace(0, last_ns - first_ns, _KNOTS).round().astype(np.int64) + first_ns
    knots = relative_poses(poses, knots_ns, to_ns)[:, :3].reshape(_KNOTS, 12).T
    table = np.empty((12, (_KNOTS - 1) * _STEPS + 1), np.float32)
    share = np.arange(_STEPS) / _STEPS
    between = knots[:, :-1, None] + np.diff(knots)[:, :, None] * share
    table[:, :-1] = between.reshape(12, -1)
    table[:, -1] = knots[:, -1]
    return table


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
        points = move_points(points, times, poses, to)
    else:
        (moved,) = relative_poses(poses, np.array([times], np.int64), to)
        extrinsics = extrinsics @ moved
    return project_points(
        points, calibration.intrinsics, extrinsics, size, occlusion=calibration.occlusion
    )


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
