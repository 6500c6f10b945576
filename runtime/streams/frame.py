"""Messages of sensors, their outcomes, and the frame that is made of them."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.contract.degraded import DEPTH_REUSED, DEPTH_UNCOMPENSATED, POINTS_UNTIMED
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import DepthMotion, Scan, project_compensated
from runtime.geometry.poses import NoPoseError, PoseTrack


class Sensor(StrEnum):
    """Where a message comes from."""

    IMAGE = "image"
    DEPTH = "depth"
    POSE = "pose"


# The sensors whose messages are matched with each other.
MATCHED = (Sensor.IMAGE, Sensor.DEPTH)


class Outcome(StrEnum):
    """The outcome of a message."""

    ANSWERED = "answered"
    # Dropped:
    OVERTAKEN = "overtaken"  # live: a newer frame was complete before its turn
    INCOMPLETE = "incomplete"  # live: an image without depth gave way to a complete frame
    UNREAD = "unread"  # live: its result was not fetched before the next one was ready
    OVERFLOW = "overflow"  # live: too many messages were waiting
    DUPLICATE = "duplicate"  # a stamp that this sensor has sent before
    LATE = "late"  # older than an image that was already decided
    CLOSED = "closed"  # pushed after the stream was closed
    # Unmatched:
    NO_IMAGE = "no_image"  # depth: no image within max_skew_ms
    REUSED = "reused"  # depth: only used by an image without depth of its own
    CLOCK_JUMP = "clock_jump"  # depth: it waited when the stamps jumped back
    # Errors:
    BAD_STAMP = "bad_stamp"
    BAD_MESSAGE = "bad_message"  # an array of a wrong shape or dtype, or with invalid values
    INPUT_ERROR = "input_error"  # image and depth do not fit each other, or the model
    INFERENCE_ERROR = "inference_error"


UNMATCHED = frozenset({Outcome.NO_IMAGE, Outcome.REUSED, Outcome.CLOCK_JUMP})
ERRORS = frozenset(
    {Outcome.BAD_STAMP, Outcome.BAD_MESSAGE, Outcome.INPUT_ERROR, Outcome.INFERENCE_ERROR}
)
DROPPED = frozenset(Outcome) - UNMATCHED - ERRORS - {Outcome.ANSWERED}


@dataclass(frozen=True, eq=False)
class Message:
    """A message of a sensor: an image, a scan, a depth map or a pose.

    Attributes:
        stamp: the stamp that was given, see `Stamp`; nanoseconds in a recording; None: not known.
        stamp_ns: the same in nanoseconds; 0 = not known.
        data: uint8 (H, W, 3), a `Scan`, float32 (H, W) in metres, or a pose, 4 x 4. While messages
            of a recording are matched, this is the place where the source finds the data.
        arrived_ns: time when the message was pushed, by the clock of the stream.
    """

    stamp: Any = None
    stamp_ns: int = 0
    data: Any = None
    arrived_ns: int = 0


class CompensatedDepth(NamedTuple):
    """A sparse depth map.

    Attributes:
        sparse_depth: float32 (H, W), metres, 0 = no return.
        motion: "each" if each return was moved by its own time, "scan" if the scan was moved as a
            whole, "none" if it was not moved.
        degraded: reasons as in `Prediction.degraded`.
        lost_points: see `Cleaned`.
    """

    sparse_depth: NDArray[np.float32]
    motion: DepthMotion
    degraded: tuple[str, ...]
    lost_points: int = 0


@dataclass(frozen=True, eq=False)
class Frame:
    """An image, its depth, and the calibration and poses that move the depth into the image.

    Attributes:
        image: message of the image.
        depth: message of the depth; None: there is no depth.
        reused: whether the depth is an older message, whose outcome is counted elsewhere.
        calibration: calibration of the camera and, for a scan, of the LiDAR; None: not known.
        poses: poses of the LiDAR over the time of the frame; None if the car has no poses.
        name: name of the frame in its recording.
    """

    image: Message
    depth: Message | None = None
    reused: bool = False
    calibration: Calibration | None = None
    poses: PoseTrack | None = None
    name: str = ""

    @property
    def own_depth(self) -> Message | None:
        """The depth message that shares the outcome of the image; None if the depth is reused."""
        return None if self.reused else self.depth

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """The image: uint8 (H, W, 3), RGB."""
        rgb: NDArray[np.uint8] = self.image.data
        return rgb

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the image."""
        return self.rgb.shape[0], self.rgb.shape[1]

    @property
    def sparse_depth(self) -> NDArray[np.float32]:
        """The returns in the image: float32 (H, W), metres along the optical axis, 0 = none."""
        return self.compensated.sparse_depth

    @property
    def depth_motion(self) -> DepthMotion | None:
        """How the returns were moved, see `CompensatedDepth`; None if there is no depth."""
        return None if self.depth is None else self.compensated.motion

    @property
    def degraded(self) -> tuple[str, ...]:
        """Faults of the depth: reasons for `Prediction.degraded`."""
        return self.compensated.degraded

    @cached_property
    def compensated(self) -> CompensatedDepth:
        """The depth at the time of the image; a scan is moved and projected, a map is unchanged.

        Raises:
            InputError: if the calibration that projects a scan is of images of another size.
        """
        depth, image_ns = self.depth, self.image.stamp_ns
        if depth is None:
            return CompensatedDepth(np.zeros(self.size, np.float32), "none", ())
        scan = depth.data
        reasons: tuple[str, ...] = (DEPTH_REUSED,) if self.reused else ()
        if not isinstance(scan, Scan):
            is_apart = self.poses is not None and depth.stamp_ns != image_ns
            reasons += (DEPTH_UNCOMPENSATED,) if self.reused or is_apart else ()
            return CompensatedDepth(scan, "none", reasons)
        points, times, lost, untimed = scan
        calibration, poses, size = self.calibration, self.poses, self.size
        assert calibration is not None  # required by what takes scans
        reasons += (POINTS_UNTIMED,) if untimed else ()
        if poses is not None and times is not None:
            try:
                moved = project_compensated(calibration, points, times, poses, image_ns, size)
                motion: DepthMotion = "scan" if isinstance(times, int) else "each"
                return CompensatedDepth(moved, motion, reasons, lost)
            except NoPoseError as error:
                reasons += (DEPTH_UNCOMPENSATED, error.reason)
        elif self.reused:
            reasons += (DEPTH_UNCOMPENSATED,)
        return CompensatedDepth(calibration.project(points, size), "none", reasons, lost)
