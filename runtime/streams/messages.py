"""Messages of sensors, as measured or still in their recording, and their outcomes."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from runtime.base.stamp import Stamp
from runtime.geometry.motion import find_returns


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


@dataclass(frozen=True, eq=False, kw_only=True)
class Message:
    """What a sensor sent; made as an `Image`, `Depth`, `Scan` or `Pose`.

    Attributes:
        stamp_ns: the stamp in nanoseconds; None: not known.
        given: the stamp as it was pushed, see `Stamp`; None: in nanoseconds.
        arrived_ns: time when the message was pushed, by the clock of the stream.
    """

    sensor: ClassVar[Sensor]
    stamp_ns: int | None = None
    given: Stamp | None = None
    arrived_ns: int = 0

    @property
    def stamp(self) -> Stamp | None:
        """The stamp as it was given; None: not known."""
        return self.stamp_ns if self.given is None else self.given

    @property
    def time_ns(self) -> int:
        """The stamp [ns] of a message that has one."""
        assert self.stamp_ns is not None
        return self.stamp_ns


@dataclass(frozen=True, eq=False)
class Image(Message):
    """An image: uint8 (H, W, 3), RGB."""

    sensor = Sensor.IMAGE
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Depth(Message):
    """A depth map: float32 (H, W), metres along the optical axis, 0 = no return."""

    sensor = Sensor.DEPTH
    sparse_depth: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Scan(Message):
    """The returns of a scan, made by `of`.

    Attributes:
        points: float32 (N, 3) or wider, metres, LiDAR frame.
        times: nanoseconds: int64 (N,), or one time for all; None if the times are not known yet.
        lost: number of points that were left out.
        untimed: whether returns were left out because their times do not belong to the scan.
    """

    sensor = Sensor.DEPTH
    points: NDArray[np.float32]
    times: NDArray[np.int64] | int | None = None
    lost: int = 0
    untimed: bool = False

    @classmethod
    def of(
        cls, points: Any, after_s: NDArray[np.float64] | None = None, stamp_ns: int | None = None
    ) -> "Scan":
        """Make a scan without points that are no returns and without returns whose time is wrong.

        Args:
            points: float32 (N, 3) or wider, see `is_return`; they are not copied if all are
                returns.
            after_s: (N,), seconds after the stamp, see `point_times`; None if they are not known.
            stamp_ns: time stamp of the scan; None: not known.

        Raises:
            InputError: if the array has another type or shape, if its points cannot be metres, or
                if half of the returns are more than 1 s from the stamp.
        """
        kept, untimed = find_returns(points, after_s)
        times = None
        if after_s is not None:
            times = (stamp_ns or 0) + np.rint(after_s[kept] * 1e9).astype(np.int64)
        lost = int(np.count_nonzero(~kept))
        return cls(points[kept] if lost else points, times, lost, untimed, stamp_ns=stamp_ns)


@dataclass(frozen=True, eq=False)
class Pose(Message):
    """A pose of the car: float64 (4, 4), rigid."""

    sensor = Sensor.POSE
    matrix: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Place:
    """A message of a recording that is not read yet.

    Attributes:
        sensor: the sensor that sent it.
        at: where its source finds it: a path, or a position in the recording.
        stamp_ns: its stamp.
    """

    sensor: Sensor
    at: Path | int
    stamp_ns: int

    @property
    def time_ns(self) -> int:
        """The stamp."""
        return self.stamp_ns
