"""The poses of the car, and the time of each scan."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.live.payload import Points
from runtime.sync.depth_in_time import FIRST_SCAN_NS, MIDDLE_AFTER, check_scan_stamp
from runtime.sync.intervals import Intervals
from runtime.sync.matching import Pair
from runtime.sync.motion import lidar_mount
from runtime.sync.poses import PoseBuffer, PoseFrame, PoseTrack, check_pose


class PoseFeed:
    """Poses and the instants of scans, as the options say. Not thread-safe.

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
        self._scan_stamp = check_scan_stamp(scan_stamp)
        self._scans = Intervals()
        self.buffer = PoseBuffer()
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

    def check(self, pose: Any) -> NDArray[np.float64]:
        """Check a pose; raises InputError."""
        if self._mount is None:
            raise InputError('poses need pose_frame="lidar", "camera" or "body"')
        return check_pose(pose)

    def timed(self, depth: Any, stamp_ns: int) -> Any:
        """A scan with its time, which is that of its middle if its points have no times.

        Called once for each depth message; a depth map is returned as it is.
        """
        if not isinstance(depth, Points):
            return depth
        later = MIDDLE_AFTER[self._scan_stamp] * (self._scans.period_ns() or FIRST_SCAN_NS)
        self._scans.add(stamp_ns)
        return depth.measured_at(stamp_ns + round(later))

    def reach(self, pair: Pair) -> bool:
        """Whether poses were given up to the end of a frame; for a car without poses, always."""
        newest_ns = self.buffer.newest_ns
        return self._mount is None or (newest_ns is not None and newest_ns >= _span_ns(pair)[1])

    def track(self, pair: Pair) -> PoseTrack | None:
        """The poses of the LiDAR over the time of a frame; None for a car without poses."""
        if self._mount is None:
            return None
        return self.buffer.between(*_span_ns(pair)).mounted(self._mount)


def _span_ns(pair: Pair) -> tuple[int, int]:
    """(Earliest, latest) of the times of a frame's image and returns."""
    first_ns = last_ns = pair.image.stamp_ns
    if pair.depth is not None and isinstance(pair.depth.data, Points):
        first_ns = min(first_ns, pair.depth.data.first_ns)
        last_ns = max(last_ns, pair.depth.data.last_ns)
    return first_ns, last_ns
