"""Times in the recording in which a sensor was out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from runtime.app.run.frame_record import CAMERA_SILENT, LIDAR_SILENT, FrameRecord
from runtime.checks.frame_health import LIDAR_EMPTY, LIDAR_FROZEN
from runtime.checks.sensor_times import find_silences
from runtime.streams.messages import Sensor

_LONGEST_NS = 3600 * 10**9  # a longer gap shows that the clock was set
_SILENT = {Sensor.IMAGE: CAMERA_SILENT, Sensor.DEPTH: LIDAR_SILENT}
_WORDS = {
    CAMERA_SILENT: "camera silent",
    LIDAR_SILENT: "LiDAR silent",
    LIDAR_EMPTY: "LiDAR empty",
    LIDAR_FROZEN: "LiDAR repeats itself",
}
# Number of scans before the first one that can be found to repeat earlier ones.
_BEFORE = {LIDAR_EMPTY: 0, LIDAR_FROZEN: 2}

_Records = Sequence[FrameRecord]
_Stamps = Mapping[Sensor, Sequence[int]]  # of all messages of a recording


@dataclass(frozen=True)
class Outage:
    """A part of a run in which a sensor did not send what it should.

    Attributes:
        reason: one of `REASONS`.
        start_s, end_s: seconds from the start of the recording; None if its times are unknown.
        scans: number of scans that were empty or repeated; None if the sensor was silent.
        first: name of the first frame of these scans.
        camera: camera of a rig with several; "" stands for the only camera.
    """

    reason: str
    start_s: float | None = None
    end_s: float | None = None
    scans: int | None = None
    first: str = ""
    camera: str = ""

    @property
    def text(self) -> str:
        """The outage in words, such as "camera silent 8.1 to 10.0 s"."""
        text = f"{self.camera}: {_WORDS[self.reason]}" if self.camera else _WORDS[self.reason]
        if self.start_s is None or self.end_s is None:
            return f"{text} {self.scans} scans, from {self.first} on"
        text += f" {self.start_s:.1f} to {self.end_s:.1f} s"
        return text if self.scans is None else f"{text}, {self.scans} scans"

    def to_dict(self) -> dict[str, Any]:
        """The entry of report.json."""
        return {**asdict(self), "text": self.text}


@dataclass(frozen=True)
class Timeline:
    """The times of a run.

    Attributes:
        start_ns: the first stamp of both sensors.
        times_s: time of each frame, in seconds after the start, rising.
    """

    start_ns: int
    times_s: tuple[float, ...]

    @classmethod
    def of(cls, records: _Records, stamps_ns: _Stamps) -> "Timeline | None":
        """Return the times of frames; None if they are unknown, or come from different clocks.

        A frame without a stamp is placed between its neighbours.
        """
        known = [at for at, each in enumerate(records) if each.image_stamp_ns is not None]
        stamps = np.array([records[at].image_stamp_ns for at in known], np.int64)
        steps = np.diff(stamps)
        if len(stamps) < 2 or steps.min() <= 0 or steps.max() > _LONGEST_NS:
            return None
        of_depth = [ns for ns in stamps_ns.get(Sensor.DEPTH, ()) if _near(ns, stamps)]
        start_ns = min(int(stamps[0]), *of_depth) if of_depth else int(stamps[0])
        if set(stamps.tolist()) <= set(stamps_ns.get(Sensor.IMAGE, ())):  # also in a shard
            start_ns = min(start_ns, *stamps_ns[Sensor.IMAGE])
        seconds = (stamps - start_ns) / 1e9
        times = np.interp(np.arange(len(records)), known, seconds)
        return cls(start_ns, tuple(times.tolist()))


def _near(ns: int, stamps: Any) -> bool:
    return bool(stamps[0] - _LONGEST_NS < ns < stamps[-1] + _LONGEST_NS)


def find_outages(
    records: _Records, stamps_ns: _Stamps, timeline: Timeline | None, *, whole: bool
) -> tuple[Outage, ...]:
    """Return the times in which the sensors of a run were out, in the order of their start.

    Args:
        records: results of the frames.
        stamps_ns: stamps of all messages of the recording; empty: those of the frames are used.
        timeline: times of the frames; None: silence is not looked for.
        whole: whether the frames reach to the end of the recording.
    """
    outages = [*_in_row(records, timeline, LIDAR_EMPTY), *_in_row(records, timeline, LIDAR_FROZEN)]
    if timeline is not None:
        start, last = timeline.start_ns, timeline.start_ns + round(timeline.times_s[-1] * 1e9)
        known: dict[Sensor, Sequence[int | None]] = {
            Sensor.IMAGE: [each.image_stamp_ns for each in records],
            Sensor.DEPTH: [each.depth_stamp_ns for each in records],
        }
        known |= {sensor: stamps_ns[sensor] for sensor in known if stamps_ns.get(sensor)}
        within = {
            sensor: [ns for ns in stamps if ns is not None and ns >= start]
            for sensor, stamps in known.items()
        }
        latest = max((ns for stamps in within.values() for ns in stamps), default=last)
        end = latest if whole and latest - last < _LONGEST_NS else last
        for sensor, stamps in within.items():
            for first, until in find_silences([ns for ns in stamps if ns <= end], start, end):
                seconds = (first - start) / 1e9, (until - start) / 1e9
                outages.append(Outage(_SILENT[sensor], *seconds))
    return tuple(sorted(outages, key=lambda each: each.start_s or 0.0))


def _in_row(records: _Records, timeline: Timeline | None, reason: str) -> Iterator[Outage]:
    """Parts in which successive frames have this reason in `FrameRecord.health`."""
    numbered = [(at, each) for at, each in enumerate(records) if each.depth_source != "reused"]
    place = 0
    for is_found, group in groupby(numbered, lambda each: reason in each[1].health):
        end = place + len(list(group))
        if is_found:
            rows = numbered[max(place - _BEFORE[reason], 0) : end]
            (first, record), (last, _) = rows[0], rows[-1]
            outage = Outage(reason, scans=len(rows), first=record.name)
            if timeline is not None:
                start_s, end_s = timeline.times_s[first], timeline.times_s[last]
                outage = replace(outage, start_s=start_s, end_s=end_s)
            yield outage
        place = end
