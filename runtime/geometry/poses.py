"""Poses of a moving sensor by time: a bounded buffer, and interpolation between its poses.

This module uses no threads and no clocks. Between two poses, rotations are interpolated by slerp
and positions linearly. Before the first and after the last pose, constant motion is assumed for at
most `MAX_EXTRAPOLATION_MS`. Elsewhere there is no pose, and `NoPoseError` says why.
"""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from enum import StrEnum
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from runtime.base.arguments import check_integer, shown
from runtime.base.arrays import Bools, Float64, Int64
from runtime.base.errors import InputError
from runtime.base.stamp import JUMP_BACK_NS, NS_PER_MS
from runtime.contract.degraded import NO_POSE, POSE_CLOCK, POSE_GAP, POSE_JUMP
from runtime.geometry.rigid import nearest_rigid

MAX_EXTRAPOLATION_MS = 100.0
# Longest time between two poses over which they are interpolated. A car with 10 m/s² leaves the
# straight line by 8 cm in this time.
MAX_GAP_MS = 250.0
# Number of poses in a `PoseBuffer`: 80 s at 100 Hz.
CAPACITY = 8192
_OTHER_CLOCK_NS = 10_000 * NS_PER_MS  # a picture and poses this far apart have different clocks
_MOST_NS = 2**62  # largest stamp, so that the difference of two stamps fits into int64
_MAX_GAP_NS = round(MAX_GAP_MS * NS_PER_MS)
_REACH_NS = round(MAX_EXTRAPOLATION_MS * NS_PER_MS)
_VELOCITY_NS = 100 * NS_PER_MS  # velocities are averaged over this time
_stamp_ns = attrgetter("stamp_ns")
# What a car can do between two poses; beyond these limits, the odometry jumped.
_SPEED_M_S, _ACCELERATION_M_S2, _JUMP_M = 100.0, 10.0, 0.5
_TURN_DEG_S, _TURN_DEG_S2, _JUMP_DEG = 180.0, 400.0, 5.0


class PoseFrame(StrEnum):
    """The frame whose poses are given."""

    LIDAR = "lidar"
    CAMERA = "camera"
    BODY = "body"


def check_pose_frame(value: Any) -> PoseFrame:
    """Return the frame of poses, also from its name as text. Raises InputError for another word."""
    try:
        return PoseFrame(value)
    except ValueError as error:
        names = ", ".join(PoseFrame)
        raise InputError(f"pose_frame must be one of {names}, got {shown(value)}") from error


class NoPoseError(InputError):
    """There is no pose for a time.

    Attributes:
        reason: "no_pose", "pose_gap", "pose_jump" or "pose_clock", as in `Prediction.degraded`.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(f"{reason}: {text}")
        self.reason = reason


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses over a period of time, made by `PoseBuffer.between` or `PoseTrack.of`.

    Attributes:
        stamps_ns: int64 (N,), rising.
        quaternions: float64 (N, 4), w, x, y, z.
        positions: float64 (N, 3), metres.
        jumped: bool (N,), whether the pose does not continue the motion of the one before it.
        mount: float64 (4, 4) from the frame to be moved to the frame of the poses.
    """

    stamps_ns: Int64
    quaternions: Float64
    positions: Float64
    jumped: Bools
    mount: Float64

    @classmethod
    def of(cls, poses: Any, stamps_ns: Any) -> "PoseTrack":
        """Make a track from the poses of a whole recording.

        Args:
            poses: float (N, 4, 4), rigid, from the moving frame to a fixed one [m].
            stamps_ns: N integers, rising.

        Raises:
            InputError: if a pose is not rigid, if the stamps are not whole numbers or do not rise,
                or if their number differs from that of the poses.
        """
        counts = [len(each) if hasattr(each, "__len__") else None for each in (poses, stamps_ns)]
        if counts[0] is None or counts[0] != counts[1]:
            raise InputError(f"expected a stamp for each pose, got {shown(counts)} of them")
        buffer = PoseBuffer(capacity=max(1, len(poses)))
        for pose, stamp in zip(poses, stamps_ns, strict=True):
            stamp_ns = check_integer("a stamp", stamp, -_MOST_NS, _MOST_NS, "ns", error=InputError)
            if buffer.newest_ns is not None and stamp_ns <= buffer.newest_ns:
                raise InputError(
                    f"the stamps of poses must increase, got {stamp_ns} after a later one"
                )
            buffer.add(nearest_rigid("pose", pose), stamp_ns)
        return buffer.whole()

    def mounted(self, mount: Float64) -> "PoseTrack":
        """Return the motion of a frame that `mount`, (4, 4), transforms to the poses' frame."""
        return replace(self, mount=mount)

    def at(self, times_ns: Int64) -> Float64:
        """Return the poses at some times, float64 (M, 4, 4), all in one fixed frame.

        Args:
            times_ns: int64 (M,).

        Raises:
            NoPoseError: if there is no pose for one of the times, or the motion jumped between
                them.
        """
        if not len(times_ns):
            return np.zeros((0, 4, 4))
        first_ns, last_ns = int(times_ns.min()), int(times_ns.max())
        stamps_ns = self.stamps_ns
        if not len(stamps_ns):
            raise NoPoseError(NO_POSE, "no poses were given")
        before_ns, after_ns = int(stamps_ns[0]) - first_ns, last_ns - int(stamps_ns[-1])
        if before_ns > 0 or after_ns > 0:
            beyond_ns = max(before_ns, after_ns)
            reason = POSE_CLOCK if beyond_ns > _OTHER_CLOCK_NS else NO_POSE
            raise NoPoseError(
                reason,
                f"{beyond_ns / NS_PER_MS:g} ms beyond the poses and the "
                f"{MAX_EXTRAPOLATION_MS:g} ms for which they are extrapolated",
            )
        # The segment that ends at pose `end`. A time that equals a pose's stamp needs only this
        # pose.
        end = np.searchsorted(stamps_ns, times_ns, side="left")
        on_pose = stamps_ns[end] == times_ns
        start = np.where(on_pose, end, end - 1)
        if self.jumped[start.min() + 1 : end.max() + 1].any():
            raise NoPoseError(POSE_JUMP, "the poses jump between the returns and the picture")
        lengths_ns = stamps_ns[end] - stamps_ns[start]
        if (lengths_ns > _MAX_GAP_NS).any():
            raise NoPoseError(
                POSE_GAP,
                f"{lengths_ns.max() / NS_PER_MS:g} ms without a pose, at most {MAX_GAP_MS:g} ms "
                "are interpolated",
            )
        weights = (times_ns - stamps_ns[start]) / np.maximum(lengths_ns, 1)
        poses = np.zeros((len(times_ns), 4, 4))
        poses[:, :3, :3] = rotations(
            _slerp(self.quaternions[start], self.quaternions[end], weights)
        )
        step = self.positions[end] - self.positions[start]
        poses[:, :3, 3] = self.positions[start] + weights[:, None] * step
        poses[:, 3, 3] = 1
        return np.asarray(poses @ self.mount)


class _Pose(NamedTuple):
    stamp_ns: int
    quaternion: Float64
    position: Float64
    jumped: bool = False


class PoseBuffer:
    """Keeps the newest poses of one moving frame, at least `capacity` of them.

    A pose that is older than the newest one is ignored. If stamps go back by more than a second,
    the clock was reset, and all older poses are removed.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._poses: list[_Pose] = []

    @property
    def newest_ns(self) -> int | None:
        """The stamp of the newest pose."""
        return self._poses[-1].stamp_ns if self._poses else None

    def add(self, pose: Float64, stamp_ns: int) -> bool:
        """Add a pose that `nearest_rigid` returned; return False if it is ignored as not newer."""
        newest_ns = self.newest_ns
        if newest_ns is not None and stamp_ns <= newest_ns:
            if stamp_ns >= newest_ns - JUMP_BACK_NS:
                return False
            self._poses.clear()
        taken = _Pose(stamp_ns, quaternion_of(pose[:3, :3]), pose[:3, 3].copy())
        jumped = bool(self._poses) and self._is_jump(taken)
        self._poses.append(taken._replace(jumped=jumped))
        if len(self._poses) >= 2 * self._capacity:  # rarely, because it copies the list
            del self._poses[: -self._capacity]
        return True

    def whole(self) -> PoseTrack:
        """All poses, with the extrapolation at both ends."""
        return self.between(-_MOST_NS, _MOST_NS)

    def between(self, first_ns: int, last_ns: int) -> PoseTrack:
        """Copy the poses for the times from `first_ns` to `last_ns`, and one on each side."""
        newest = len(self._poses) - 1
        start = max(bisect_right(self._poses, first_ns, key=_stamp_ns) - 1, 0)
        stop = bisect_left(self._poses, last_ns, key=_stamp_ns) + 1
        # Return at least the nearest pose: its distance in time tells the cause.
        start = min(start, max(newest, 0))
        poses = self._poses[start : max(stop, start + 1)]
        if poses:
            if last_ns > self._poses[newest].stamp_ns:
                poses = poses + self._extrapolated(newest, -1, last_ns)
            if first_ns < self._poses[0].stamp_ns:
                poses = self._extrapolated(0, 1, first_ns) + poses
        return PoseTrack(
            np.array([pose.stamp_ns for pose in poses], np.int64),
            np.array([pose.quaternion for pose in poses], np.float64).reshape(-1, 4),
            np.array([pose.position for pose in poses], np.float64).reshape(-1, 3),
            np.array([pose.jumped for pose in poses], bool),
            np.eye(4),
        )

    def _base(self, end: int, step: int) -> int | None:
        """The pose from which the velocity at pose `end` is computed; None if there is none.

        With a `step` of -1 it is a pose before `end`, with 1 a pose after it.
        """
        poses, base = self._poses, end

        def apart_ns(other: int) -> int:
            return abs(poses[other].stamp_ns - poses[end].stamp_ns)

        while 0 <= base + step < len(poses) and not poses[max(base, base + step)].jumped:
            if base != end and apart_ns(base + step) > _VELOCITY_NS:
                break
            base += step
        return base if 0 < apart_ns(base) <= _MAX_GAP_NS else None

    def _extrapolated(self, end: int, step: int, stamp_ns: int) -> list[_Pose]:
        """The pose at a time at most `_REACH_NS` beyond pose `end`; empty without a velocity."""
        base = self._base(end, step)
        if base is None:
            return []
        end_ns = self._poses[end].stamp_ns
        return [self._beyond(base, end, min(max(stamp_ns, end_ns - _REACH_NS), end_ns + _REACH_NS))]

    def _beyond(self, base: int, end: int, stamp_ns: int) -> _Pose:
        """Where the motion from pose `base` to pose `end` leads at a time beyond `end`."""
        first, last = self._poses[base], self._poses[end]
        weight = np.array([(stamp_ns - first.stamp_ns) / (last.stamp_ns - first.stamp_ns)])
        (quaternion,) = _slerp(first.quaternion[None], last.quaternion[None], weight)
        position = first.position + weight * (last.position - first.position)
        return _Pose(stamp_ns, quaternion, position)

    def _is_jump(self, pose: _Pose) -> bool:
        """Whether a car cannot reach the next pose from the poses before it."""
        newest = len(self._poses) - 1
        last = expected = self._poses[newest]
        after_s = (pose.stamp_ns - last.stamp_ns) / 1e9
        base = self._base(newest, -1)
        if base is None:
            far_m, far_deg = _SPEED_M_S * after_s, _TURN_DEG_S * after_s
        else:
            expected = self._beyond(base, newest, pose.stamp_ns)
            base_s = (last.stamp_ns - self._poses[base].stamp_ns) / 1e9
            square_s2 = after_s * (after_s + base_s)
            far_m, far_deg = _ACCELERATION_M_S2 * square_s2, _TURN_DEG_S2 * square_s2
        cosine = min(1.0, abs(float(expected.quaternion @ pose.quaternion)))
        is_far = np.linalg.norm(pose.position - expected.position) > _JUMP_M + far_m
        return bool(is_far or np.degrees(2 * np.arccos(cosine)) > _JUMP_DEG + far_deg)


def quaternion_of(rotation: Float64) -> Float64:
    """w, x, y, z of a rotation matrix, by its largest component (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    choices = (a + e + i, a - e - i, e - a - i, i - a - e)
    largest = choices.index(max(choices))
    rows = (
        (1 + choices[0], h - f, c - g, d - b),
        (h - f, 1 + choices[1], b + d, c + g),
        (c - g, b + d, 1 + choices[2], f + h),
        (d - b, c + g, f + h, 1 + choices[3]),
    )
    quaternion = np.array(rows[largest])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def _slerp(first: Float64, second: Float64, weights: Float64) -> Float64:
    """Unit quaternions (M, 4) between two, on the shorter way; weights outside 0..1 extrapolate."""
    cosine = np.einsum("ij,ij->i", first, second)
    second = np.where(cosine[:, None] < 0, -second, second)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    sine = np.sin(angle)
    even = sine < 1e-6  # here sin(x) = x to the last bit
    sine = np.where(even, 1.0, sine)
    of_first = np.where(even, 1 - weights, np.sin((1 - weights) * angle) / sine)
    of_second = np.where(even, weights, np.sin(weights * angle) / sine)
    between = of_first[:, None] * first + of_second[:, None] * second
    return np.asarray(between / np.linalg.norm(between, axis=1, keepdims=True))


def rotations(quaternions: Float64) -> Float64:
    """Rotation matrices (M, 3, 3) of unit quaternions."""
    w, x, y, z = quaternions.T
    matrices = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.moveaxis(matrices, 2, 0)
