"""Charts of the page, filled into chart.html and strip.html; lengths are percent of a chart."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from runtime.app.run.frame_record import INVALID, OK, SKIPPED, FrameRecord
from runtime.app.run.reasons import LATE

UNANSWERED = (SKIPPED, INVALID)  # frames without a usable answer
_MOST_SPANS = 490  # in one chart
_MOST_TICKS = 6
_GAP = 2.5  # periods without a frame that count as a gap
_MOST_POINTS = 140  # with more spans, a chart draws points for late ones only
_LEAST_BAR = 0.25  # width of a bar in percent of its strip

# Left, width and height in percent, and opacity from 0 to 1.
Bar = tuple[float, float, float, float]


def frame_marks(record: FrameRecord) -> set[str]:
    """What is wrong with a frame: its status, "late", `Prediction.degraded`, and health."""
    marks = {*record.health, *record.degraded}
    if record.status != OK:
        marks.add(record.status)
    if record.deadline_met is False:
        marks.add(LATE)
    return marks


@dataclass(frozen=True)
class Axis:
    """The horizontal axis of the charts: seconds from the start of the recording, or frames.

    Attributes:
        places: place of each frame on the axis, rising.
        period: distance from a frame to the next one, without gaps.
        end: where the charts end; the last frame takes a period, too. They start at 0.
        unit: "s", or "frame" if the times are unknown.
    """

    places: Sequence[float]
    period: float
    end: float
    unit: str

    @classmethod
    def of(cls, frames: int, times_s: Sequence[float] | None, end_s: float = 0.0) -> "Axis":
        """Return the axis for so many frames at these times; None if the times are unknown.

        `end_s` is the end of the last outage.
        """
        if times_s is None or len(times_s) < 2:
            return cls(range(frames), 1.0, max(float(frames), 1.0), "frame")
        steps = sorted(after - before for before, after in pairwise(times_s))
        period = steps[len(steps) // 2]
        return cls(times_s, period, max(times_s[-1] + period, end_s), "s")

    def share(self, place: float) -> float:
        """Position of a place between the start (0) and the end (1)."""
        return place / self.end

    def reach(self, at: int) -> float:
        """Place at which a frame ends: that of the next one, or a period later if a gap follows."""
        after = self.places[at + 1] if at + 1 < len(self.places) else self.end
        return after if not self.is_gap(at) else self.places[at] + self.period

    def is_gap(self, at: int) -> bool:
        """Whether frames are missing after this one."""
        after = self.places[at + 1] if at + 1 < len(self.places) else self.end
        return after - self.places[at] > _GAP * self.period

    def ticks(self) -> list[tuple[float, float]]:
        """(Percent, place) of each tick."""
        least = self.end / _MOST_TICKS
        step = _distance(least if self.unit == "s" else max(least, 1))
        last = math.floor(self.end / step + 1e-9)
        return [(100 * self.share(n * step), n * step) for n in range(last + 1)]

    def title(self, first: int, last: int, name: str) -> str:
        """Frames in words, for a tooltip; `name` is the name of the first frame."""
        if self.unit == "s":
            till = "" if first == last else f" to {self.places[last]:.2f}"
            return f"{self.places[first]:.2f}{till} s"
        return name if first == last else f"frames {first} to {last}"


@dataclass(frozen=True)
class Span:
    """Successive frames that share a place in the charts; `first` is the number of the first."""

    first: int
    records: Sequence[FrameRecord]
    axis: Axis

    @property
    def last(self) -> int:
        """Number of the last frame."""
        return self.first + len(self.records) - 1

    @property
    def start(self) -> float:
        """Place at which the span starts on the axis."""
        return self.axis.places[self.first]

    @property
    def end(self) -> float:
        """Place at which the span ends on the axis."""
        return self.axis.reach(self.last)

    @property
    def middle(self) -> float:
        """Middle of the span's frames on the axis."""
        return (self.start + self.axis.places[self.last]) / 2

    @property
    def title(self) -> str:
        """The frames in words, for a tooltip."""
        return self.axis.title(self.first, self.last, self.records[0].name)

    @cached_property
    def times_ms(self) -> list[float]:
        """Latencies of the answered frames."""
        return [record.times_ms["latency"] for record in self.records if record.prediction]

    @property
    def slowest_ms(self) -> float:
        """Largest latency of the answered frames; there must be at least one."""
        return max(self.times_ms)

    @cached_property
    def marks(self) -> Counter[str]:
        """Number of frames with each mark."""
        return Counter(mark for record in self.records for mark in frame_marks(record))

    @cached_property
    def mean_returns(self) -> float | None:
        """Mean number of returns used; None if no frame was answered."""
        returns = [each.prediction.depth_returns for each in self.records if each.prediction]
        return sum(returns) / len(returns) if returns else None


def group_frames(records: Sequence[FrameRecord], axis: Axis) -> list[Span]:
    """The spans of a run, with one frame each, or with several if there are too many frames.

    No span contains a gap.
    """
    frames = -(-len(records) // _MOST_SPANS) or 1  # in a span
    spans, first = [], 0
    for at in range(len(records)):
        if at + 1 - first == frames or at + 1 == len(records) or axis.is_gap(at):
            spans.append(Span(first, records[first : at + 1], axis))
            first = at + 1
    return spans


def latency_chart(spans: Sequence[Span], *, deadline_ms: float | None) -> dict[str, Any]:
    """Draw the latency of the slowest frame of each span, the deadline, and unanswered frames.

    Returns the values for chart.html, or {} if no frame was answered.
    """
    answered = [span for span in spans if span.times_ms]
    if not answered:
        return {}
    limits = [] if deadline_ms is None else [deadline_ms]
    highest = max([*limits, *(span.slowest_ms for span in answered)])
    step, axis = _distance(highest / 5), spans[0].axis
    top = step * max(math.ceil(highest / step), 1)

    def x(place: float) -> float:
        return 100 * axis.share(place) if len(spans) > 1 else 50.0

    def y(value_ms: float) -> float:
        return 100 * (1 - value_ms / top)

    points = []
    for span in answered:
        late = span.marks[LATE]
        if late or len(spans) <= _MOST_POINTS:
            text = f"{span.title}: {span.slowest_ms:.1f} ms"
            if len(span.records) > 1:
                text += f" at most, {late} late"
            points.append((LATE if late else "point", x(span.middle), y(span.slowest_ms), text))
    return {
        "ticks": [(y(step * tick), step * tick) for tick in range(round(top / step) + 1)],
        "along": axis.ticks(),
        "unit": axis.unit,
        "joined": any(len(span.records) > 1 for span in spans),
        "lines": [
            " ".join(f"{x(span.middle):.2f},{y(span.slowest_ms):.2f}" for span in run)
            for run in _lines(spans)
        ],
        "deadline": [y(limit) for limit in limits],
        "unanswered": [
            (x(span.middle), f"{span.title}: {' '.join(kinds)}")
            for span in spans
            if (kinds := [mark for mark in UNANSWERED if span.marks[mark]])
        ],
        "points": points,
    }


def _lines(spans: Sequence[Span]) -> list[list[Span]]:
    """Lists of answered spans that follow each other without a gap."""
    lines: list[list[Span]] = [[]]
    for span in spans:
        if span.times_ms:
            lines[-1].append(span)
        if not span.times_ms or span.axis.is_gap(span.last):
            lines.append([])
    return [line for line in lines if line]


def outage_strip(axis: Axis, places: Sequence[tuple[float, float]]) -> list[Bar]:
    """A bar for each of these parts of the axis."""
    return [_bar(axis.share(first), axis.share(last)) for first, last in places]


def _distance(least: float) -> float:
    """The distance between ticks: 1, 2 or 5 times a power of ten, and at least `least`."""
    steps = (step * 10.0**power for power in range(-6, 10) for step in (1, 2, 5))
    return next(step for step in steps if step >= least)


def mark_strip(spans: Sequence[Span], mark: str) -> list[Bar]:
    """The bars of the spans in which a mark occurs, darker if more frames have it."""
    return [
        _bar(span.axis.share(span.start), span.axis.share(span.end), opacity=0.6 + 0.4 * share)
        for span in spans
        if (share := span.marks[mark] / len(span.records))
    ]


def returns_strip(spans: Sequence[Span]) -> list[Bar]:
    """A bar for each span, whose height is its mean number of LiDAR returns."""
    most = max(span.mean_returns or 0 for span in spans) or 1
    return [
        _bar(span.axis.share(span.start), span.axis.share(span.end), height=returns / most)
        for span in spans
        if (returns := span.mean_returns) is not None
    ]


def _bar(start: float, end: float, *, height: float = 1.0, opacity: float = 1.0) -> Bar:
    """A bar between two places of a strip; all numbers are shares."""
    return 100 * start, max(100 * (end - start), _LEAST_BAR), 100 * height, opacity
