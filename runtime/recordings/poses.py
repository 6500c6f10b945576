"""Files of time stamps, and of poses: KITTI's, TUM's, and KITTI raw's oxts.

Formats: A. Geiger et al., KITTI odometry development kit and "Vision meets Robotics", 2013;
J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", 2012.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.base.stamp import parse_date, parse_seconds
from runtime.files.read_input import read_text
from runtime.geometry.rigid import finite_matrix, nearest_rigid

_KITTI, _TUM, _OXTS = 12, 8, 30
_EARTH_RADIUS_M = 6378137.0


def read_timestamps(path: Path) -> list[int]:
    """Read a file with rising times, one per line: seconds, or dates as in KITTI's raw data.

    Returns:
        The times in nanoseconds.

    Raises:
        InputError: if the file cannot be read, if a line is not a time, or if a time is not later
            than the one before.
    """
    stamps_ns: list[int] = []
    for number, line in enumerate(read_text(path).rstrip().splitlines(), 1):
        where = f"line {number} of {path}"
        stamps_ns.append((parse_date if ":" in line else parse_seconds)(line, where))
        if number > 1 and stamps_ns[-1] <= stamps_ns[-2]:
            raise InputError(f"{where} is {line!r:.60}, expected a later time than the line before")
    return stamps_ns


def read_kitti_poses(path: Path) -> NDArray[np.float64]:
    """Read a file of poses with 12 numbers a line, as KITTI odometry and kiss-icp write them.

    The numbers of a line are a 3 x 4 matrix, row by row.

    Returns:
        float64 (N, 4, 4), one pose for each line.

    Raises:
        InputError: if the file cannot be read or a line is no such matrix.
    """
    rows = _numbers(path, _KITTI)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    return poses


def read_tum_poses(path: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read a file of "time x y z qx qy qz qw" lines, as TUM's benchmark and evo write them.

    Returns:
        Nanoseconds, int64 (N,), and poses, float64 (N, 4, 4).

    Raises:
        InputError: if the file cannot be read, or if a line does not hold a time [s] and a pose.
    """
    rows = _numbers(path, _TUM)
    names = [f"line {number} of {path}" for number in range(1, len(rows) + 1)]
    # A float64 of 1.6e9 s has a resolution of 0.2 µs, so nanoseconds are read from the text.
    times = [line.split()[0] for line in _lines(path)]
    stamps_ns = [parse_seconds(*each) for each in zip(times, names, strict=True)]
    poses = [pose_of(row[1:4], row[4:8], name) for row, name in zip(rows, names, strict=True)]
    return np.array(stamps_ns, np.int64), np.array(poses).reshape(-1, 4, 4)


def read_oxts_poses(paths: Iterable[Path]) -> NDArray[np.float64]:
    """Read the files of KITTI raw's oxts/data, one for each frame.

    Args:
        paths: the files in the order of the frames. Each begins with latitude and longitude
            [degrees], altitude [m], roll, pitch and yaw [rad].

    Returns:
        float64 (N, 4, 4), poses of the IMU on a Mercator plane scaled at the first latitude.

    Raises:
        InputError: if a file cannot be read.
    """
    poses: list[NDArray[np.float64]] = []
    scale = 0.0
    for path in paths:
        row = _numbers(path, _OXTS)
        if len(row) != 1:
            raise InputError(f"{path} must have one line of {_OXTS} numbers, it has {len(row)}")
        latitude, longitude, altitude, *angles = row[0, :6]
        if not (abs(latitude) < 89 and abs(longitude) <= 360 and np.abs(angles).max() < 7):
            raise InputError(
                f"{path} must begin with latitude and longitude [degrees], altitude [m], roll, "
                f"pitch and yaw [radians], got {shown(row[0, :6].tolist())}"
            )
        scale = scale or _EARTH_RADIUS_M * np.cos(np.radians(latitude))
        roll, pitch, yaw = (cv2.Rodrigues(turn)[0] for turn in np.diag(angles))
        pose = np.eye(4)
        pose[:3, :3] = yaw @ pitch @ roll
        north = np.log(np.tan(np.radians(90 + latitude) / 2))
        pose[:3, 3] = scale * np.radians(longitude), scale * north, altitude
        poses.append(pose)
    moved = np.array(poses).reshape(-1, 4, 4)
    moved[:, :3, 3] -= moved[:1, :3, 3]
    return moved


def read_poses(
    path: Path, stamps_ns: Sequence[int], *, of_clock: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read the poses of a folder's frames: KITTI's format, one line per frame, or TUM's format.

    Args:
        path: the file of poses.
        stamps_ns: time stamps of the frames.
        of_clock: whether the stamps are times of a clock, which TUM's format needs.

    Returns:
        Nanoseconds, int64 (N,), and poses, float64 (N, 4, 4).

    Raises:
        InputError: in the cases of `read_kitti_poses` and `read_tum_poses`; if the number of lines
            is not the number of frames; and for TUM's format if the frames have no times.
    """
    first = next(iter(_lines(path)), "")
    if len(first.split()) == _TUM:
        if not of_clock:
            raise InputError(f"{path} has times, the frames have none: give `timestamps=`")
        return read_tum_poses(path)
    poses = read_kitti_poses(path)
    if len(poses) != len(stamps_ns):
        raise InputError(
            f"{path} has {len(poses)} poses, there are {len(stamps_ns)} images: it must have a "
            "line for each image, in natural order"
        )
    return np.array(stamps_ns, np.int64), poses


def pose_of(
    position: Iterable[float], quaternion: Iterable[float], name: str
) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a position [m] and a unit quaternion x, y, z, w.

    Raises:
        InputError: if the numbers are not finite, and in the cases of `nearest_rigid`.
    """
    pose = np.eye(4)
    pose[:3, 3] = tuple(position)
    x, y, z, w = numbers = np.array(tuple(quaternion), np.float64)
    norm, cross = numbers @ numbers, np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    with np.errstate(divide="ignore", invalid="ignore"):
        pose[:3, :3] += 2 / norm * (w * cross + cross @ cross)
    pose[:3, :3] *= norm**0.25  # a length off by 1 % makes the matrix off by 1 %
    return nearest_rigid(f"{name}, x, y, z and a unit quaternion,", pose)


def _lines(path: Path) -> list[str]:
    lines = (line.partition("#")[0] for line in read_text(path).splitlines())
    return [line for line in lines if line.strip()]


def _numbers(path: Path, count: int) -> NDArray[np.float64]:
    """The numbers of a text file, float64 (lines, count); "#" begins a comment."""
    rows = [
        finite_matrix(f"line {number} of {path}", line.split(), 1, count)
        for number, line in enumerate(_lines(path), 1)
    ]
    return np.array(rows).reshape(-1, count)
