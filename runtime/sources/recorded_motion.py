"""What the sources of moving cars share: frames matched by stamps, and poses of the recording."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import (
    FIRST_SCAN_NS,
    MIDDLE_AFTER,
    ScanStamp,
    check_scan_stamp,
    lidar_mount,
)
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.sources.source import ListedFrame, up_to
from runtime.sync.frame import Message
from runtime.sync.matching import Decided, match_by_stamp
from runtime.sync.outcome import Sensor

_WAITING = 64  # messages of a sensor that wait for the other one, which may be recorded later


@dataclass(frozen=True, eq=False)
class RecordedPoses:
    """The poses of a recording.

    Attributes:
        track: poses of `frame`.
        frame: of which poses are given.
        body_from_lidar: as of `Calibration`, where the calibration has none.
    """

    track: PoseTrack
    frame: PoseFrame
    body_from_lidar: NDArray[np.float64] | None = None

    def of_lidar(self, calibration: Calibration) -> PoseTrack:
        """The poses of the LiDAR. Raises InputError if the calibration does not have its place."""
        if calibration.body_from_lidar is None:
            calibration = replace(calibration, body_from_lidar=self.body_from_lidar)
        return self.track.mounted(lidar_mount(self.frame, calibration))


def track_of(stamped: Iterable[tuple[int, NDArray[np.float64]]]) -> PoseTrack:
    """The track of poses in any order; of equal stamps the first. Raises InputError."""
    first: dict[int, NDArray[np.float64]] = {}
    for stamp_ns, pose in stamped:
        first.setdefault(stamp_ns, pose)
    stamps_ns = sorted(first)
    return PoseTrack.of([first[stamp_ns] for stamp_ns in stamps_ns], stamps_ns)


def _stem(image: Message) -> str:
    return str(image.data.stem)


def match_frames(
    messages: Iterable[tuple[Sensor, int, Any]],
    *,
    max_skew_ms: float,
    reuse_depth_ms: float,
    scan_stamp: ScanStamp,
    left_out: Counter[str],
    limit: int | None,
    name: Callable[[Message], str] = _stem,
    camera_only: bool = False,
) -> tuple[ListedFrame, ...]:
    """List the frames of messages, see `match_by_stamp`.

    Args:
        messages: (sensor, stamp in nanoseconds, data) in the order of the recording; the data are
            `ListedFrame.image` and `depth`.
        max_skew_ms: as of `match_by_stamp`.
        reuse_depth_ms: as of `match_by_stamp`.
        scan_stamp: what instant of a scan its stamp is.
        left_out: counts each message that is in no frame: "image: duplicate", and so on.
        limit: as of `Source.list_frames`.
        name: of the frame of an image; the default is for data that are paths.
        camera_only: whether the recording has no depth, so that images alone are complete.

    Raises:
        InputError: as `match_by_stamp`, and for an unknown `scan_stamp`.
    """
    check_scan_stamp(scan_stamp)

    def count(decided: Decided) -> None:
        left_out.update(f"{gone.sensor}: {gone.outcome}" for gone in decided.discarded)

    def listed() -> Iterator[ListedFrame]:
        matched = match_by_stamp(
            ((sensor, Message(stamp_ns, stamp_ns, data)) for sensor, stamp_ns, data in messages),
            max_skew_ms=max_skew_ms,
            reuse_depth_ms=reuse_depth_ms,
            waiting=_WAITING,
            on_decided=count,
        )
        for sequence, frame in enumerate(matched):
            image, depth = frame.image, frame.depth
            of_image = sequence, name(image), image.data
            if depth is None:
                yield ListedFrame(*of_image, None, image.stamp_ns, complete=camera_only)
            else:
                stamps_ns = image.stamp_ns, depth.stamp_ns
                own = not frame.reused
                yield ListedFrame(*of_image, depth.data, *stamps_ns, own, frame.reused)

    frames = up_to(listed(), limit)
    scans_ns = sorted({each.depth_stamp_ns for each in frames if each.depth_stamp_ns is not None})
    period_ns = np.median(np.diff(scans_ns)) if len(scans_ns) > 1 else FIRST_SCAN_NS
    later_ns = round(MIDDLE_AFTER[scan_stamp] * float(period_ns))
    return tuple(
        each
        if each.depth_stamp_ns is None
        else replace(each, scan_time_ns=each.depth_stamp_ns + later_ns)
        for each in frames
    )


def left_out_note(left_out: Counter[str]) -> tuple[str, ...]:
    """A line for people about the messages that are in no frame; none if there are none."""
    if not left_out:
        return ()
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(left_out.items()))
    return (f"left out: {counts}",)
