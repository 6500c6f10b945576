"""What sensors send: its checks, the poses of the car, and the time of each scan."""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.assumptions import assume
from runtime.checks import shown
from runtime.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import (
    FIRST_SCAN_NS,
    MIDDLE_AFTER,
    Scan,
    check_scan_stamp,
    lidar_mount,
    point_times,
)
from runtime.geometry.poses import PoseBuffer, PoseFrame
from runtime.geometry.rigid import read_rigid
from runtime.preprocess import check_rgb, check_sparse_depth
from runtime.returns import check_points
from runtime.sync.frame import Frame, Outcome, Sensor
from runtime.sync.matching import Intervals

_SHORTEST_NS = 10**6  # between depth messages: shorter ones are of integers of another unit
Kind = Literal["image", "depth", "points", "pose"]
SENSORS: dict[str, Sensor] = {
    "image": Sensor.IMAGE,
    "depth": Sensor.DEPTH,
    "points": Sensor.DEPTH,
    "pose": Sensor.POSE,
}


class SensorInput:
    """Checks of messages, poses and the instants of scans. Only `check` is thread-safe.

    Args:
        pose_frame: "lidar", "camera" or "body"; None = a car without poses.
        scan_stamp: "start", "middle" or "end".
        calibration: of camera and LiDAR.

    Raises:
        InputError: if an option is unknown, or the calibration is none or missing.
    """

    def __init__(self, pose_frame: Any, scan_stamp: Any, calibration: Calibration | None) -> None:
        if not isinstance(calibration, Calibration | None):
            raise InputError(f"calibration must be a Calibration or None, got {shown(calibration)}")
        self._calibration = calibration
        self._middle_after = MIDDLE_AFTER[check_scan_stamp(scan_stamp)]
        self._scans = Intervals()
        self.poses = PoseBuffer()
        self._mount: NDArray[np.float64] | None = None
        if pose_frame is not None:
            frames = [str(each) for each in PoseFrame]
            if pose_frame not in frames:
                raise InputError(
                    f"pose_frame must be one of {', '.join(frames)} or None, got "
                    f"{shown(pose_frame)}"
                )
            if calibration is None:
                raise InputError("pose_frame needs a calibration: give calibration=")
            self._mount = lidar_mount(PoseFrame(pose_frame), calibration)

    def check(self, kind: Kind, data: Any, stamp_ns: int, times: Any = None) -> Any:
        """Return a copy of what a sensor sends, a scan as `Scan`; raises InputError."""
        match kind:
            case "image":
                return check_rgb(data).copy()
            case "depth":
                is_map = isinstance(data, np.ndarray) and data.ndim == 2
                # The size of its image is not known yet.
                return check_sparse_depth(data, size=data.shape if is_map else (0, 0)).copy()
            case "pose":
                if self._mount is None:
                    raise InputError('poses need pose_frame="lidar", "camera" or "body"')
                return read_rigid("pose", data)
        if self._calibration is None:
            raise InputError("points need a calibration to be projected: give calibration=")
        check_points(data)
        after_s = None if times is None else point_times(times, len(data), stamp_ns)
        return Scan.of(data.copy(), after_s, stamp_ns)

    def timed(self, depth: Any, stamp_ns: int) -> Any:
        """A scan with its time, which is that of its middle if its points have no times.

        Called once for each depth message; a depth map is returned as it is.
        """
        period_ns = self._scans.period_ns() or FIRST_SCAN_NS
        if period_ns < _SHORTEST_NS:
            assume(f"stamps of depth {period_ns} apart are nanoseconds", "give seconds as floats")
        later = self._middle_after * period_ns
        self._scans.add(stamp_ns)
        if not isinstance(depth, Scan):
            return depth
        return depth if depth.times is not None else depth._replace(times=stamp_ns + round(later))

    def take_pose(self, pose: NDArray[np.float64], stamp_ns: int) -> Outcome:
        """Keep a pose that is newer than the last one; a stamp far back is of a new clock."""
        newest_ns = self.poses.newest_ns
        if self.poses.add(pose, stamp_ns):
            return Outcome.ANSWERED
        return Outcome.DUPLICATE if stamp_ns == newest_ns else Outcome.LATE

    def reaches(self, frame: Frame) -> bool:
        """Whether poses were given up to the end of a frame; for a car without poses, always."""
        newest_ns = self.poses.newest_ns
        return self._mount is None or (newest_ns is not None and newest_ns >= _span_ns(frame)[1])

    def complete(self, matched: Frame) -> Frame:
        """The frame with the calibration, and with the poses of the LiDAR over its time."""
        poses = None
        if self._mount is not None:
            poses = self.poses.between(*_span_ns(matched)).mounted(self._mount)
        return replace(matched, calibration=self._calibration, poses=poses)


def _span_ns(frame: Frame) -> tuple[int, int]:
    """(Earliest, latest) of the times of a frame's image and returns."""
    times = [np.int64(frame.image.stamp_ns)]
    if frame.depth is not None and isinstance(frame.depth.data, Scan):
        of_points = np.asarray(frame.depth.data.times)
        if of_points.size:
            times += [of_points.min(), of_points.max()]
    return int(min(times)), int(max(times))
