"""Poses, transforms between frames and times of points from deserialised ROS messages."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import cut, shown
from runtime.base.errors import InputError
from runtime.geometry.assumptions import assume
from runtime.geometry.returns import is_return
from runtime.recordings.poses import pose_of
from runtime.recordings.ros_answers import FixedTransform
from runtime.recordings.ros_messages import view_fields

# Names that drivers give to the field with the time of each point; the first one present counts.
TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
# NumPy's types for the datatypes of such a field.
_TIMES = {2: "u1", 4: "u2", 6: "u4", 5: "i4", 7: "f4", 8: "f8"}
_HALVES = {6: "u4", 5: "i4"}  # seconds and nanoseconds
# A scan takes 1 ms to 1 s.
_SHORTEST_SCAN_NS, _LONGEST_SCAN_NS = 1e6, 1e9
_LEAST_EPOCH_NS = 1e17  # nanoseconds since 1970, in 1973
_UNITS_NS = (10**9, 10**6, 10**3, 1)
_REMEDY = "`pose_topic=none` leaves scans as they are"
# A pose that moves less than this share of the way that its twists state is not filled.
_LEAST_SHARE, _LEAST_WAY_M = 0.01, 1.0
# Fixed frames of REP 105, and the names that SLAM programs use for them.
_FIXED = ("odom", "map", "earth", "world", "camera_init")
StampedPoses = list[tuple[int, NDArray[np.float64]]]  # time stamps [ns] and poses


def odometry_pose(message: Any) -> NDArray[np.float64]:
    """Return the pose in a nav_msgs/Odometry or geometry_msgs/TransformStamped, float64 (4, 4).

    It is from the message's child frame to its frame.

    Raises:
        InputError: if the quaternion does not have unit length, or if a number is not finite.
    """
    if hasattr(message, "transform"):
        name = f"the transform from {message.header.frame_id} to {message.child_frame_id}"
        return _pose(message.transform.translation, message.transform.rotation, name)
    return _pose(message.pose.pose.position, message.pose.pose.orientation, "an Odometry")


def point_times_s(
    message: Any, stamp_ns: int, points: NDArray[np.float32]
) -> NDArray[np.float64] | None:
    """Return when each point of a PointCloud2 was measured, in seconds after the stamp.

    The unit is the one in which the values span a scan, 1 ms to 1 s; seconds may span less.

    | type | values | meaning |
    |---|---|---|
    | floats | up to 1 s in this unit | s (Velodyne), ms, us or ns after the stamp |
    | float64 | larger | s (Hesai, RoboSense), ms, us or ns (Livox) of the clock |
    | integers | over a span of 1 ms | ns after the stamp (Ouster, Autoware, Livox) |
    | integers | others | us or ms, or ns if these are no scan either, with a warning |
    | two 32-bit integers | any | s and ns of the clock |

    Other values are an error. The middle nine tenths of the returns decide, because single times
    may be broken.

    Args:
        message: sensor_msgs/PointCloud2.
        stamp_ns: time stamp in its header.
        points: float32 (N, 3) or wider, as `decode_points` returns them.

    Returns:
        float64 (N,), NaN where the field holds NaN; None if the message has no such field, or if
        all returns have the same time.

    Raises:
        InputError: if the field has another type or ends beyond the point, or if the data are
            truncated.
    """
    field = next((f for name in TIME_FIELDS for f in message.fields if f.name == name), None)
    if field is None:
        return None
    if field.count == 2:
        after_ns = _clock_times_ns(message, field) - stamp_ns
        return None if np.ptp(after_ns) == 0 else after_ns / 1e9
    times = view_fields(message, [field], _TIMES)[field.name].ravel()
    values: NDArray[np.float64] = times.astype(np.float64)
    known = values[is_return(points) & np.isfinite(values)]
    if not known.size or known.min() == known.max():
        return None  # the driver does not fill it
    lowest, highest = np.percentile(known, (5, 95))
    if times.dtype.kind in "iu":
        return values * _unit_of_integers(highest - lowest, field.name) / 1e9
    unit_ns, is_clock = _unit(lowest, highest, times.dtype.itemsize, field.name)
    # float64 cannot hold nanoseconds since 1970 exactly, so a whole number is subtracted first.
    first = int(lowest) if is_clock else 0
    shift_ns = first * unit_ns - stamp_ns if is_clock else 0
    return ((values - first) * unit_ns + shift_ns) / 1e9


def _clock_times_ns(message: Any, field: Any) -> NDArray[np.int64]:
    """The times of points whose field holds seconds and nanoseconds of the clock."""
    halves = [
        SimpleNamespace(name=name, offset=field.offset + offset, datatype=field.datatype, count=1)
        for name, offset in ((field.name, 0), (f"{field.name} (ns)", 4))
    ]
    seconds, rest = (view_fields(message, [h], _HALVES)[h.name].ravel() for h in halves)
    times: NDArray[np.int64] = seconds.astype(np.int64) * 10**9 + rest
    return times


def _unit_of_integers(span: float, name: str) -> int:
    """Nanoseconds per unit of integers that span a scan."""
    if span >= _SHORTEST_SCAN_NS:
        return 1
    fitting = (u for u in (10**3, 10**6) if _SHORTEST_SCAN_NS < span * u <= _LONGEST_SCAN_NS)
    unit_ns = next(fitting, 1)
    words = {1: "nanoseconds", 10**3: "microseconds", 10**6: "milliseconds"}
    assume(f"{name} of a scan is {words[unit_ns]}, since all times are within {span:g}", _REMEDY)
    return unit_ns


def _unit(lowest: float, highest: float, size: int, name: str) -> tuple[int, bool]:
    """(Nanoseconds per unit, whether it is the clock's) by the table of `point_times_s`."""
    largest, span = max(abs(lowest), abs(highest)), highest - lowest
    for unit_ns in _UNITS_NS:
        longest = _LONGEST_SCAN_NS / unit_ns
        if span > longest or (span * unit_ns < _SHORTEST_SCAN_NS and unit_ns < 10**9):
            continue
        if largest <= longest:
            return unit_ns, False
        if size == 8 and (unit_ns == 10**9 or lowest * unit_ns >= _LEAST_EPOCH_NS):
            return unit_ns, True
    raise InputError(
        f"the field {name} of a PointCloud2 has values from {lowest:g} to {highest:g}, expected "
        f"times of a scan of up to 1 s, after the stamp or of the clock: {_REMEDY}"
    )


def odometry_poses(messages: Iterable[Any]) -> tuple[str, StampedPoses]:
    """Return the frame that moves, and the poses of nav_msgs/Odometry with their stamps [ns].

    Raises:
        InputError: if there are no messages or several frames of either kind, and in the cases of
            `odometry_pose`.
    """
    frames: set[str] = set()
    fixed: set[str] = set()
    poses, twists = [], []
    for message in messages:
        frames.add(frame_name(message.child_frame_id))
        fixed.add(frame_name(message.header.frame_id))
        poses.append((_stamp_ns(message.header), odometry_pose(message)))
        speed = message.twist.twist.linear
        twists.append(np.linalg.norm([speed.x, speed.y, speed.z]))
    if len(frames) != 1:
        got = ", ".join(sorted(frames)) or "none"
        raise InputError(f"an Odometry must be of one child_frame_id, got {got}")
    if len(fixed) > 1:
        raise InputError(f"an Odometry must be in one frame, got {', '.join(sorted(fixed))}")
    stamps_s, places = np.array([ns for ns, _ in poses]) / 1e9, [pose[:3, 3] for _, pose in poses]
    stated_m = float(np.nanmedian(twists) * np.ptp(stamps_s))
    if stated_m > _LEAST_WAY_M and np.ptp(places, axis=0).max() < _LEAST_SHARE * stated_m:
        raise InputError(
            f"its pose does not move, although its twist states {stated_m:.0f} m: give the poses "
            "of another topic by `pose_topic=`"
        )
    return frames.pop(), poses


def transform_poses(messages: Iterable[Any], carriers: Sequence[str]) -> tuple[str, StampedPoses]:
    """Return the frame that moves, and its poses in /tf with their stamps [ns].

    Args:
        messages: tf2_msgs/TFMessage.
        carriers: the LiDAR's frame and the frames to which it is fixed.

    Raises:
        InputError: if none of the carriers moves, if it moves in a frame that moves itself (odom,
            map and earth of REP 105 are fixed), and in the cases of `odometry_pose`.
    """
    moving: dict[str, StampedPoses] = {}
    parents: dict[str, str] = {}
    for message in messages:
        for stamped in message.transforms:
            child, parent = frame_name(stamped.child_frame_id), frame_name(stamped.header.frame_id)
            if child in carriers and parents.get(child, parent) != parent:
                raise InputError(
                    f"/tf moves {shown(child)} in {shown(parents[child])} and in {shown(parent)}: "
                    "expected one of them"
                )
            parents[child] = parent
            if child in carriers:
                pose = odometry_pose(stamped)
                moving.setdefault(child, []).append((_stamp_ns(stamped.header), pose))
    carrier = next((frame for frame in carriers if frame in moving), None)
    if carrier is None:
        raise InputError(f"/tf moves none of the frames {', '.join(carriers):.300}")
    fixed = parents[carrier]
    if fixed in parents and not is_world_frame(fixed):
        raise InputError(
            f"/tf moves {carrier!r:.80} in {fixed!r:.80}, which moves itself in "
            f"{parents[fixed]!r:.80}: expected one of {', '.join(_FIXED)}"
        )
    return carrier, moving[carrier]


class TransformTree:
    """The transforms of /tf_static between frames; if a child has several, the last one counts.

    Its methods raise InputError if a transform between the frames in question is invalid. Other
    transforms may be invalid.

    Args:
        messages: tf2_msgs/TFMessage.
        remedy: what to do if frames are not connected.
    """

    def __init__(self, messages: Iterable[Any], remedy: str = "give `calibration=`") -> None:
        self._remedy = remedy
        self._parents: dict[str, list[tuple[str, Any]]] = {}
        for message in messages:
            for stamped in message.transforms:
                child, parent = map(frame_name, (stamped.child_frame_id, stamped.header.frame_id))
                self._parents.setdefault(child, []).append((parent, stamped))

    def between(self, source: str, target: str) -> NDArray[np.float64]:
        """Return the matrix from the frame `source` to the frame `target` [m], float64 (4, 4).

        Raises:
            InputError: if the two are not connected.
        """
        from_source, from_target = self.ancestors(source), self.ancestors(target)
        common = next((frame for frame in from_source if frame in from_target), None)
        if common is None:
            raise InputError(
                f"/tf_static does not connect the frame {shown(source)} to {shown(target)}, it has "
                f"{cut(', '.join(self.frames), 300) or 'no frames'}: {self._remedy}"
            )
        matrix: NDArray[np.float64] = np.linalg.inv(from_target[common]) @ from_source[common]
        matrix[3] = (0, 0, 0, 1)  # exact to the last bit
        return matrix

    @property
    def frames(self) -> list[str]:
        """The names of all frames."""
        parents = (parent for stated in self._parents.values() for parent, _ in stated)
        return sorted({*self._parents, *parents})

    def valid(self) -> Iterator[FixedTransform]:
        """Yield the last transform of each child whose last transform is valid."""
        for child, stated in self._parents.items():
            for parent, stamped in reversed(stated):
                with contextlib.suppress(InputError):
                    yield FixedTransform.of(parent, child, odometry_pose(stamped))
                    break

    def ancestors(self, frame: str) -> dict[str, NDArray[np.float64]]:
        """A frame, its parent and so on up to the root, with matrices from the frame to each."""
        frame = frame_name(frame)
        matrices = {frame: np.eye(4)}
        while frame in self._parents:
            *others, (parent, stamped) = self._parents[frame]
            if parent in matrices:
                raise InputError(f"/tf_static has a cycle at the frame {shown(parent)}")
            pose = odometry_pose(stamped)
            for each, other in others:
                with contextlib.suppress(InputError):  # the transform is invalid
                    if each != parent or not np.allclose(odometry_pose(other), pose, atol=1e-3):
                        assume(f"the last of several transforms of {frame}", "/tf_static has more")
            matrices[parent] = pose @ matrices[frame]
            frame = parent
        return matrices


def is_world_frame(frame: str) -> bool:
    """Whether the name of a frame says that it does not move with the car."""
    return frame.rpartition("/")[2] in _FIXED


def frame_name(frame: Any) -> str:
    """The name of a frame without the leading slash that some ROS 1 drivers add."""
    return str(frame).removeprefix("/")


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _pose(position: Any, quaternion: Any, name: str) -> NDArray[np.float64]:
    place = position.x, position.y, position.z
    turn = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return pose_of(place, turn, name)
