"""Messages of sensors: their checks and counts, the poses of the car, and the time of a scan."""

from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.base.stamp import Stamp, stamp_ns
from runtime.checks.sensor_times import LiveClocks
from runtime.engine.preprocess import check_rgb, check_sparse_depth
from runtime.geometry.assumptions import assume
from runtime.geometry.motion import FIRST_SCAN_NS, assume_middle, lidar_mount, point_times
from runtime.geometry.poses import PoseBuffer, PoseTrack
from runtime.geometry.returns import check_points
from runtime.geometry.rig import Rig
from runtime.geometry.rigid import nearest_rigid
from runtime.streams.frame import Frame
from runtime.streams.matching import Intervals, Pair
from runtime.streams.messages import Depth, Image, Message, Outcome, Pose, Scan, Sensor
from runtime.streams.stream_counter import StreamCounter

_SHORTEST_NS = 10**6  # between depth messages; shorter intervals come from integers of another unit
Kind = Literal["image", "depth", "points", "pose"]
SENSORS: dict[str, Sensor] = {
    "image": Sensor.IMAGE,
    "depth": Sensor.DEPTH,
    "points": Sensor.DEPTH,
    "pose": Sensor.POSE,
}


class SensorInput:
    """Accepts the messages of a car's sensors and counts them. Only `check` is thread-safe.

    Args:
        rig: the car's sensors.
        counter: counts each message.
        lock: held wherever the counter is used; `check` takes it, other callers hold it.

    Raises:
        InputError: if the calibration cannot be read, or is missing although poses need it.
    """

    def __init__(
        self, rig: Rig, *, counter: StreamCounter, lock: AbstractContextManager[Any]
    ) -> None:
        if not isinstance(rig, Rig):
            raise InputError(f"rig must be a Rig, such as Rig(calibration=...), got {shown(rig)}")
        self._calibration, self._counter, self._lock = rig.read_calibration(), counter, lock
        self._middle_after = rig.stamp_to_middle
        self._is_middle_assumed = rig.scan_stamp is None
        self._scans, self._clocks = Intervals(), LiveClocks()
        self._poses = PoseBuffer()
        self._mount: NDArray[np.float64] | None = None
        if rig.pose_frame is not None:
            if self._calibration is None:
                raise InputError("pose_frame needs a calibration: give Rig(calibration=)")
            self._mount = lidar_mount(rig.pose_frame, self._calibration)

    def check(self, kind: Kind, data: Any, stamp: Stamp, times: Any = None) -> Message:
        """Return a checked copy of a message; `take` counts it.

        Raises InputError after it has counted an invalid message as an error.
        """
        sensor, outcome = SENSORS[kind], Outcome.BAD_STAMP
        try:
            nanoseconds = stamp_ns(stamp)
            outcome = Outcome.BAD_MESSAGE
            return replace(self._checked_copy(kind, data, nanoseconds, times), given=stamp)
        except InputError:
            with self._lock:
                self._counter.push(sensor, outcome)
            raise

    def _checked_copy(self, kind: Kind, data: Any, stamp_ns: int, times: Any) -> Message:
        calibration = self._calibration
        if kind == "pose":
            if self._mount is None:
                raise InputError('poses need Rig(pose_frame="lidar"), "camera" or "body"')
            return Pose(nearest_rigid("pose", data), stamp_ns=stamp_ns)
        if kind == "points" and calibration is None:
            raise InputError("points need a calibration to be projected: give Rig(calibration=)")
        if kind == "points":
            check_points(data)
            after_s = None if times is None else point_times(times, len(data), stamp_ns)
            return Scan.of(data.copy(), after_s, stamp_ns)
        if kind == "image":
            check_rgb(data)
        else:
            is_map = isinstance(data, np.ndarray) and data.ndim == 2
            # The size of its image is not known yet.
            check_sparse_depth(data, size=data.shape if is_map else (0, 0))
        if calibration is not None:
            calibration.require_size(data.shape[:2])
        return (Image if kind == "image" else Depth)(data.copy(), stamp_ns=stamp_ns)

    def take(self, message: Message) -> Message | None:
        """Count a checked message; return the message to be matched, or None for a pose.

        A scan whose points have no times gets the time of its middle.
        """
        if isinstance(message, Pose):
            newest_ns = self._poses.newest_ns
            outcome = Outcome.DUPLICATE if message.stamp_ns == newest_ns else Outcome.LATE
            if self._poses.add(message.matrix, message.time_ns):
                outcome = Outcome.ANSWERED
            self._counter.push(message.sensor, outcome)
            return None
        self._counter.push(message.sensor)
        period_ns = self._scans.period_ns() or FIRST_SCAN_NS
        is_image, is_scan = isinstance(message, Image), isinstance(message, Scan)
        if message.arrived_ns:  # in a live stream
            ahead_ns = message.time_ns - message.arrived_ns
            self._clocks.add(ahead_ns, period_ns, is_image=is_image, is_scan=is_scan)
        if is_image:
            return message
        if period_ns < _SHORTEST_NS:
            assume(f"stamps of depth {period_ns} apart are nanoseconds", "give seconds as floats")
        self._scans.add(message.time_ns)
        if not isinstance(message, Scan) or message.times is not None:
            return message
        if self._is_middle_assumed and self._mount is not None:
            self._is_middle_assumed = False
            assume_middle()
        return replace(message, times=message.time_ns + round(self._middle_after * period_ns))

    def reaches(self, pair: Pair[Message]) -> bool:
        """Return whether poses reach the end of a pair; True if the car has no poses."""
        newest_ns = self._poses.newest_ns
        return self._mount is None or (newest_ns is not None and newest_ns >= _span_ns(pair)[1])

    def poses_of(self, pair: Pair[Message]) -> PoseTrack | None:
        """Return the poses of the LiDAR over the time of a pair; None if the car has no poses."""
        if self._mount is None:
            return None
        return self._poses.between(*_span_ns(pair)).mounted(self._mount)

    def complete(self, pair: Pair[Message], poses: PoseTrack | None) -> Frame:
        """Return the frame of a pair, its scan projected; other threads may use the input."""
        image, depth = pair.image, pair.depth
        assert isinstance(image, Image)
        assert isinstance(depth, Depth | Scan | None)
        return Frame(image, depth, pair.reused, self._calibration, poses)


def _span_ns(pair: Pair[Message]) -> tuple[int, int]:
    """Return the (earliest, latest) time of a pair's image and returns."""
    times = [np.int64(pair.image.time_ns)]
    if isinstance(pair.depth, Scan):
        of_points = np.asarray(pair.depth.times)
        if of_points.size:
            times += [of_points.min(), of_points.max()]
    return int(min(times)), int(max(times))
