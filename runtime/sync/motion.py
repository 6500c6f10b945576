"""Move the returns of a LiDAR on a moving car to one time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.projection import project_points
from runtime.sync.poses import PoseFrame, PoseTrack, check_pose

#: A scan's times are rounded to so many steps: 24 µs of 100 ms, 1 mm at 40 m/s.
_STEPS = 4096


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
    steps = min(_STEPS, last_ns - first_ns + 1)
    knots_ns = first_ns + np.round(np.linspace(0, last_ns - first_ns, steps)).astype(np.int64)
    table = relative_poses(poses, knots_ns, to)[:, :3].astype(np.float32)
    table = np.ascontiguousarray(table.reshape(steps, 12).T)
    index: Any = None
    if steps > 1:
        place = (times - first_ns).astype(np.float32)
        place *= np.float32((steps - 1) / (last_ns - first_ns))
        place += np.float32(0.5)
        index = place.astype(np.intp)
    moved = points.copy()
    axes = np.ascontiguousarray(points[:, :3].T)
    factor = np.empty(len(points), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # returns that are not finite stay so
        for row in range(3):
            for column, axis in enumerate(axes):
                if index is None:
                    factor[:] = table[4 * row + column, 0]
                else:
                    table[4 * row + column].take(index, out=factor, mode="clip")
                factor *= axis
                if column == 0:
                    total = factor.copy()
                else:
                    total += factor
            shift = table[4 * row + 3]
            total += shift[0] if index is None else shift.take(index, mode="clip")
            moved[:, row] = total
    return moved


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
        points: as of `move_points`.
        times: as of `move_points`.
        poses: as of `move_points`.
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
