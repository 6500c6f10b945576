"""Poses, transforms between frames and times of points from deserialised ROS messages."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
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
_TIMES = {6: "u4", 5: "i4", 7: "f4", 8: "f8"}
_LONGEST_SCAN_S = 1.0
# Least value of nanoseconds since 1970 (a time in 1973), and least span of a scan in microseconds.
_LEAST_EPOCH_NS, _LEAST_SPAN_US, _LEAST_SPAN_NS = 1e17, 1e3, 1e6
# Fixed frames of REP 105, and the names that SLAM programs use for them.
_FIXED = ("odom", "map", "earth", "world", "camera_init")


def odometry_pose(message: Any) -> NDArray[np.float64]:
    """Return the pose in a nav_msgs/Odometry: float64 (4, 4), from its child frame to its frame.

    Raises:
        InputError: if the quaternion does not have unit length, or if a number is not finite.
    """
    return _pose(message.pose.pose.position, message.pose.pose.orientation, "an Odometry")


def point_times_s(
    message: Any, stamp_ns: int, points: NDArray[np.float32]
) -> NDArray[np.float64] | None:
    """Return when each point of a PointCloud2 was measured, in seconds after the stamp.

    | type | values | meaning |
    |---|---|---|
    | int32, uint32 | any; assumed if below 1 ms | ns after the stamp (Ouster, Autoware, Livox) |
    | float32, float64 | up to 1 | s after the stamp (Velodyne) |
    | float32, float64 | up to 10^6, over a span of more than 10^3 | us after the stamp |
    | float64 | larger, over a span of up to 1 | s of the clock (Hesai, RoboSense) |
    | float64 | from 10^17 on, over a span of up to 10^9 | ns of the clock (Livox) |

    A scan takes at most a second; other values are an error. The middle nine tenths of the returns
    decide, because single times may be broken.

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
    times = view_fields(message, [field], _TIMES)[field.name].ravel()
    values: NDArray[np.float64] = times.astype(np.float64)
    known = values[is_return(points) & np.isfinite(values)]
    if not known.size or known.min() == known.max():
        return None  # the driver does not fill it
    lowest, highest = np.percentile(known, (5, 95))
    if times.dtype.kind in "iu":
        if highest - lowest < _LEAST_SPAN_NS:
            remedy = "pose_topic=none in --source leaves scans as they are"
            assume(f"{field.name} of a scan is nanoseconds, although all are within 1 ms", remedy)
        return values / 1e9
    unit_ns, is_clock = _unit(lowest, highest, times.dtype.itemsize, field.name)
    # float64 cannot hold nanoseconds since 1970 exactly, so a whole number is subtracted first.
    first = int(lowest) if is_clock else 0
    shift_ns = first * unit_ns - stamp_ns if is_clock else 0
    return ((values - first) * unit_ns + shift_ns) / 1e9


def _unit(lowest: float, highest: float, size: int, name: str) -> tuple[int, bool]:
    """(Nanoseconds per unit, whether it is the clock's) by the table of `point_times_s`."""
    largest, span = max(abs(lowest), abs(highest)), highest - lowest
    if largest <= _LONGEST_SCAN_S:
        return 10**9, False
    if size == 8 and span <= _LONGEST_SCAN_S:
        return 10**9, True
    if lowest >= _LEAST_EPOCH_NS and span <= _LONGEST_SCAN_S * 1e9:
        return 1, True
    if largest <= _LONGEST_SCAN_S * 1e6 and span > _LEAST_SPAN_US:
        return 10**3, False
    raise InputError(
        f"the field {name} of a PointCloud2 has values from {lowest:g} to {highest:g}, expected "
        "seconds or microseconds after the stamp, or seconds or nanoseconds of the clock"
    )


def odometry_poses(messages: Iterable[Any]) -> tuple[str, list[tuple[int, NDArray[np.float64]]]]:
    """Return the frame that moves, and the poses of nav_msgs/Odometry with their stamps [ns].

    Raises:
        InputError: if there are no messages or several frames of either kind, and in the cases of
            `odometry_pose`.
    """
    frames: set[str] = set()
    fixed: set[str] = set()
    poses = []
    for message in messages:
        frames.add(frame_name(message.child_frame_id))
        fixed.add(frame_name(message.header.frame_id))
        poses.append((_stamp_ns(message.header), odometry_pose(message)))
    if len(frames) != 1:
        raise InputError(
            f"an Odometry must be of one child_frame_id, got {', '.join(sorted(frames)) or 'none'}"
        )
    if len(fixed) > 1:
        raise InputError(f"an Odometry must be in one frame, got {', '.join(sorted(fixed))}")
    return frames.pop(), poses


def transform_poses(
    messages: Iterable[Any], carriers: Sequence[str]
) -> tuple[str, list[tuple[int, NDArray[np.float64]]]]:
    """Return the frame that moves, and its poses in /tf with their stamps [ns].

    Args:
        messages: tf2_msgs/TFMessage.
        carriers: the LiDAR's frame and the frames to which it is fixed.

    Raises:
        InputError: if none of the carriers moves, if it moves in a frame that moves itself (odom,
            map and earth of REP 105 are fixed), and in the cases of `odometry_pose`.
    """
    moving: dict[str, list[tuple[int, NDArray[np.float64]]]] = {}
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
                pose = _transform_pose(stamped)
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
    """

    def __init__(self, messages: Iterable[Any]) -> None:
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
                f"{cut(', '.join(self.frames), 300) or 'no frames'}: give --calibration"
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
                    yield FixedTransform.of(parent, child, _transform_pose(stamped))
                    break

    def ancestors(self, frame: str) -> dict[str, NDArray[np.float64]]:
        """A frame, its parent and so on up to the root, with matrices from the frame to each."""
        frame = frame_name(frame)
        matrices = {frame: np.eye(4)}
        while frame in self._parents:
            *others, (parent, stamped) = self._parents[frame]
            if parent in matrices:
                raise InputError(f"/tf_static has a cycle at the frame {shown(parent)}")
            pose = _transform_pose(stamped)
            for each, other in others:
                with contextlib.suppress(InputError):  # the transform is invalid
                    if each != parent or not np.allclose(_transform_pose(other), pose, atol=1e-3):
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


def _transform_pose(stamped: Any) -> NDArray[np.float64]:
    """The pose of `child_frame_id` in the frame of the header of a TransformStamped."""
    name = f"the transform from {stamped.header.frame_id} to {stamped.child_frame_id}"
    return _pose(stamped.transform.translation, stamped.transform.rotation, name)


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _pose(position: Any, quaternion: Any, name: str) -> NDArray[np.float64]:
    place = position.x, position.y, position.z
    turn = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return pose_of(place, turn, name)
