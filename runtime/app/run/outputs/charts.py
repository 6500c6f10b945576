"""Charts of the page, filled into chart.html and strip.html; lengths are percent of a chart."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median_high
from typing import Any

from runtime.app.run.frame_record import INVALID, LATE, OK, SKIPPED, FrameRecord

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
    marks = {*record.health, *record.degraded, record.status} - {OK}
    return marks | {LATE} if record.deadline_met is False else marks


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
        period = median_high(after - before for before, after in pairwise(times_s))
        return cls(times_s, period, max(times_s[-1] + period, end_s), "s")

    def percent(self, place: float) -> float:
        """Position of a place between the start (0) and the end (100)."""
        return 100 * place / self.end

    def after(self, at: int) -> float:
        """Place of the frame after this one, or the end."""
        return self.places[at + 1] if at + 1 < len(self.places) else self.end

    def is_gap(self, at: int) -> bool:
        """Whether frames are missing after this one."""
        return self.after(at) - self.places[at] > _GAP * self.period

    def ticks(self) -> list[tuple[float, float]]:
        """(Percent, place) of each tick."""
        least = self.end / _MOST_TICKS
        step = _distance(least if self.unit == "s" else max(least, 1))
        last = math.floor(self.end / step + 1e-9)
        return [(self.percent(n * step), n * step) for n in range(last + 1)]


class Span:
    """Successive frames that share a place in the charts.

    Attributes:
        title: the frames in words, for a tooltip.
        start, middle, end: where the span is on the axis, in percent.
        is_before_gap: whether frames are missing after it.
        slowest_ms: largest latency of the answered frames; None if there are none.
        mean_returns: mean number of returns used; None if no frame was answered.
        marks: number of frames with each mark.
        frames: number of frames.
    """

    def __init__(self, records: Sequence[FrameRecord], first: int, axis: Axis) -> None:
        last = first + len(records) - 1
        start, until = axis.places[first], axis.places[last]
        self.frames, self.is_before_gap = len(records), axis.is_gap(last)
        self.start, self.middle = axis.percent(start), axis.percent((start + until) / 2)
        self.end = axis.percent(until + axis.period if self.is_before_gap else axis.after(last))
        self.title = records[0].name if first == last else f"frames {first} to {last}"
        if axis.unit == "s":
            self.title = f"{start:.2f} s" if first == last else f"{start:.2f} to {until:.2f} s"
        answers = [each.prediction for each in records if each.prediction]
        times_ms = [each.times_ms["latency"] for each in records if each.prediction]
        self.slowest_ms = max(times_ms, default=None)
        self.mean_returns = fmean(each.depth_returns for each in answers) if answers else None
        self.marks = Counter(mark for record in records for mark in frame_marks(record))


def group_frames(records: Sequence[FrameRecord], axis: Axis) -> list[Span]:
    """The spans of a run, with one frame each, or with several if there are too many frames.

    No span contains a gap.
    """
    frames = -(-len(records) // _MOST_SPANS) or 1  # in a span
    spans, first = [], 0
    for at in range(len(records)):
        if at + 1 - first == frames or at + 1 == len(records) or axis.is_gap(at):
            spans.append(Span(records[first : at + 1], first, axis))
            first = at + 1
    return spans


def latency_chart(
    spans: Sequence[Span], axis: Axis, *, deadline_ms: float | None
) -> dict[str, Any]:
    """Draw the latency of the slowest frame of each span, the deadline, and unanswered frames.

    Returns the values for chart.html, or {} if no frame was answered.
    """
    slowest_ms = [span.slowest_ms for span in spans if span.slowest_ms is not None]
    if not slowest_ms:
        return {}
    limits = [] if deadline_ms is None else [deadline_ms]
    highest = max(*limits, *slowest_ms, 0.0)
    step = _distance(highest / 5)
    top = step * max(math.ceil(highest / step), 1)

    def x(span: Span) -> float:
        return span.middle if len(spans) > 1 else 50.0

    def y(value_ms: float) -> float:
        return 100 * (1 - value_ms / top)

    points, lines = [], [list[str]()]
    for span in spans:
        if span.slowest_ms is not None:
            at, late = (x(span), y(span.slowest_ms)), span.marks[LATE]
            lines[-1].append(f"{at[0]:.2f},{at[1]:.2f}")
            if late or len(spans) <= _MOST_POINTS:
                text = f"{span.title}: {span.slowest_ms:.1f} ms"
                if span.frames > 1:
                    text += f" at most, {late} late"
                points.append((LATE if late else "point", *at, text))
        if span.slowest_ms is None or span.is_before_gap:
            lines.append([])
    return {
        "ticks": [(y(step * tick), step * tick) for tick in range(round(top / step) + 1)],
        "along": axis.ticks(),
        "unit": axis.unit,
        "joined": any(span.frames > 1 for span in spans),
        "lines": [" ".join(line) for line in lines if line],
        "deadline": [y(limit) for limit in limits],
        "unanswered": [
            (x(span), f"{span.title}: {' '.join(kinds)}")
            for span in spans
            if (kinds := [mark for mark in UNANSWERED if span.marks[mark]])
        ],
        "points": points,
    }


def _distance(least: float) -> float:
    """The distance between ticks: 1, 2 or 5 times a power of ten, and at least `least`."""
    steps = (step * 10.0**power for power in range(-6, 10) for step in (1, 2, 5))
    return next(step for step in steps if step >= least)


def mark_strip(spans: Sequence[Span], mark: str) -> list[Bar]:
    """The bars of the spans in which a mark occurs, darker if more frames have it."""
    shares = ((span, span.marks[mark] / span.frames) for span in spans)
    return [bar(each.start, each.end, opacity=0.6 + 0.4 * part) for each, part in shares if part]


def returns_strip(spans: Sequence[Span]) -> list[Bar]:
    """A bar for each span, whose height is its mean number of LiDAR returns."""
    means = [(span, span.mean_returns) for span in spans if span.mean_returns is not None]
    most = max((mean for _, mean in means), default=0) or 1
    return [bar(span.start, span.end, height=100 * mean / most) for span, mean in means]


def bar(start: float, end: float, *, height: float = 100.0, opacity: float = 1.0) -> Bar:
    """A bar between two places of a strip, in percent."""
    return start, max(end - start, _LEAST_BAR), height, opacity
