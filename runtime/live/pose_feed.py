"""The poses of a stream, and what it does with a scan for them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.live.payload import Points
from runtime.sync.depth_in_time import FIRST_SCAN_NS, MIDDLE_AFTER, check_scan_stamp
from runtime.sync.motion import lidar_mount
from runtime.sync.poses import CAPACITY, PoseBuffer, PoseFrame, PoseTrack, check_pose
from runtime.sync.synchronizer import Pair

_AHEAD = CAPACITY // 2  # replay: poses that are newer than the last image that was decided


class PoseFeed:
    """Poses and the instants of scans, as a stream's options say; the stream's lock guards it.

    Args:
        pose_frame: "lidar", "camera" or "body"; None = a stream without poses.
        scan_stamp: "start", "middle" or "end".
        calibration: of the stream.

    Raises:
        InputError: if an option is unknown or its calibration is missing.
    """

    def __init__(self, pose_frame: Any, scan_stamp: Any, calibration: Calibration | None) -> None:
        self._scan_stamp = check_scan_stamp(scan_stamp)
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

    @property
    def expected(self) -> bool:
        """Whether the stream has poses."""
        return self._mount is not None

    def check(self, pose: Any) -> NDArray[np.float64]:
        """Check a pose that is pushed; raises InputError."""
        if not self.expected:
            raise InputError('push_pose needs pose_frame="lidar", "camera" or "body"')
        return check_pose(pose)

    def full(self, decided_ns: int | None) -> bool:
        """Whether poses are far ahead of the images, the last of which was decided then."""
        buffer = self.buffer
        return (len(buffer) if decided_ns is None else buffer.count_after(decided_ns)) >= _AHEAD

    def instant(self, scan: Points, stamp_ns: int, period_ns: int | None) -> Points:
        """A scan with its time; without times of its points, that of its middle."""
        later = MIDDLE_AFTER[self._scan_stamp] * (period_ns or FIRST_SCAN_NS)
        return scan.measured_at(stamp_ns + round(later))

    def track(self, pair: Pair) -> PoseTrack | None:
        """The poses of the LiDAR over the time of a frame; None for a stream without poses."""
        if self._mount is None:
            return None
        first_ns = last_ns = pair.image.stamp_ns
        if pair.depth is not None and isinstance(pair.depth.data, Points):
            first_ns = min(first_ns, pair.depth.data.first_ns)
            last_ns = max(last_ns, pair.depth.data.last_ns)
        return self.buffer.between(first_ns, last_ns).mounted(self._mount)
