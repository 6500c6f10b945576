"""Charts of the page, filled in by chart.html and strip.html; lengths in percent of a chart."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

from runtime.streams.frame_result import INVALID, OK, SKIPPED, FrameResult
from runtime.streams.statistics import LatencyStatistics

UNANSWERED = (SKIPPED, INVALID)  # frames without a usable answer
LATE = "late"
_MOST_SPANS = 490  # of a chart
_MOST_FRAME_TICKS = 6
_MOST_POINTS = 140  # a chart with more spans draws points for late spans only
_LEAST_BAR = 0.25  # width of a bar in percent of its strip
_LOG_FROM = 12.0  # the axis is logarithmic if maximum / median is larger
#: Distances of ticks.
_STEPS = tuple(step * 10.0**power for power in range(-6, 10) for step in (1, 2, 5))

#: Left, width and height in percent, and opacity 0..1.
Bar = tuple[float, float, float, float]


def marks_of(record: FrameResult) -> set[str]:
    """What is wrong with a frame: status, "late", `Prediction.degraded`, and health."""
    marks = {*record.health, *(record.prediction.degraded if record.prediction else ())}
    if record.status != OK:
        marks.add(record.status)
    if record.deadline_met is False:
        marks.add(LATE)
    return marks


@dataclass(frozen=True)
class Span:
    """Successive frames that share a place in the charts; `first` is the number of the first."""

    first: int
    records: Sequence[FrameResult]

    @property
    def last(self) -> int:
        """Number of the last frame."""
        return self.first + len(self.records) - 1

    @property
    def middle(self) -> float:
        """Number of the middle frame, or half between two."""
        return (self.first + self.last) / 2

    @property
    def title(self) -> str:
        """The frames in words, for a tooltip."""
        one = len(self.records) == 1
        return self.records[0].name if one else f"frames {self.first} to {self.last}"

    @cached_property
    def times_ms(self) -> list[float]:
        """Latencies of the answered frames."""
        return [each.latency_ms for each in self.records if each.latency_ms is not None]

    @property
    def mean_ms(self) -> float:
        """Mean latency of the answered frames, of which there are some."""
        return sum(self.times_ms) / len(self.times_ms)

    @cached_property
    def marks(self) -> Counter[str]:
        """Mark -> frames that have it."""
        return Counter(mark for record in self.records for mark in marks_of(record))

    @cached_property
    def mean_returns(self) -> float | None:
        """Mean number of returns used; None = no frame was answered."""
        returns = [each.prediction.depth_returns for each in self.records if each.prediction]
        return sum(returns) / len(returns) if returns else None


def join_frames(records: Sequence[FrameResult]) -> list[Span]:
    """The spans of a run: of one frame each, or of several where there are too many frames."""
    frames = -(-len(records) // _MOST_SPANS) or 1  # of a span
    return [
        Span(first, records[first : first + frames]) for first in range(0, len(records), frames)
    ]


class _Axis:
    """The vertical axis [ms]: linear from 0, or logarithmic where a few values are far off."""

    def __init__(self, lowest: float, median: float, highest: float) -> None:
        self._scale: Callable[[float], float] = float
        self.unit = "ms"
        if highest > _LOG_FROM * median and lowest > 0:
            self.unit, self._scale = "ms, logarithmic", math.log
            above = next(step for step in _STEPS if step >= highest)
            below = max((step for step in _STEPS if step <= lowest), default=lowest)
            self.ticks = [step for step in _STEPS if below <= step <= above]
        else:
            step = next(step for step in _STEPS if step >= highest / 5)
            self.ticks = [step * tick for tick in range(max(math.ceil(highest / step), 1) + 1)]

    def place(self, value: float) -> float:
        """Return where a value is on the axis: 0 at its lower end, 1 at its upper end."""
        low, high, at = map(self._scale, (self.ticks[0], self.ticks[-1], value))
        return (at - low) / (high - low)


def latency_chart(spans: Sequence[Span], *, deadline_ms: float | None) -> dict[str, Any]:
    """Draw the latencies over the frames, the deadline, late and unanswered frames.

    Where spans hold several frames, a band shows the smallest and largest latency of each. Returns
    the values of chart.html; {} if no frame was answered.
    """
    answered = [span for span in spans if span.times_ms]
    if not answered:
        return {}
    means = sorted(span.mean_ms for span in answered)
    limits = [] if deadline_ms is None else [deadline_ms]
    lowest = min(min(span.times_ms) for span in answered)
    highest = max(max(span.times_ms) for span in answered)
    axis = _Axis(min([lowest, *limits]), means[len(means) // 2], max([highest, *limits]))
    last = max(spans[-1].last, 1)

    def x(frame: float) -> float:
        return 100 * frame / last if len(spans) > 1 else 50.0

    def y(value_ms: float) -> float:
        return 100 * (1 - axis.place(value_ms))

    def path(places: Iterable[tuple[float, float]]) -> str:
        return " ".join(f"{x(frame):.2f},{y(value_ms):.2f}" for frame, value_ms in places)

    bands, lines, points = [], [], []
    for is_answered, group in groupby(spans, lambda span: bool(span.times_ms)):
        if is_answered:
            run = list(group)
            lines.append(path((span.middle, span.mean_ms) for span in run))
            above = [(span.middle, max(span.times_ms)) for span in run]
            below = [(span.middle, min(span.times_ms)) for span in reversed(run)]
            bands.append(path(above + below))
    for span in answered:
        text = f"{span.title}: {span.mean_ms:.1f} ms"
        if len(span.records) > 1:
            text += f" at the mean, {max(span.times_ms):.1f} ms at most, {span.marks[LATE]} late"
        if span.marks[LATE]:
            points.append((LATE, x(span.middle), y(max(span.times_ms)), text))
        elif len(spans) <= _MOST_POINTS:
            points.append(("point", x(span.middle), y(span.mean_ms), text))
    every = next(step for step in _STEPS if step >= max(last / _MOST_FRAME_TICKS, 1))
    return {
        "unit": axis.unit,
        "ticks": [(y(tick), tick) for tick in axis.ticks],
        "frames": [(x(frame), frame) for frame in range(0, last + 1, round(every))],
        "joined": any(len(span.records) > 1 for span in spans),  # else the bands have no height
        "bands": bands,
        "lines": lines,
        "deadline": [y(limit) for limit in limits],
        "unanswered": [
            (x(span.middle), f"{span.title}: {' '.join(kinds)}")
            for span in spans
            if (kinds := [mark for mark in UNANSWERED if span.marks[mark]])
        ],
        "points": points,
    }


def mark_strip(spans: Sequence[Span], mark: str) -> list[Bar]:
    """The bars of the spans in which a mark occurs, darker where more frames have it."""
    frames = spans[-1].last + 1
    return [
        _bar(span.first / frames, (span.last + 1) / frames, opacity=0.6 + 0.4 * share)
        for span in spans
        if (share := span.marks[mark] / len(span.records))
    ]


def returns_strip(spans: Sequence[Span]) -> list[Bar]:
    """A bar for each span, as high as its mean number of LiDAR returns."""
    frames = spans[-1].last + 1
    most = max(span.mean_returns or 0 for span in spans) or 1
    return [
        _bar(span.first / frames, (span.last + 1.03) / frames, height=span.mean_returns / most)
        for span in spans
        if span.mean_returns is not None
    ]


def range_strip(statistics: LatencyStatistics, most_ms: float) -> list[Bar]:
    """The latency of a stage: a bar from 0 to the median, and a lighter one to the maximum."""
    median, highest = statistics.median_ms / most_ms, statistics.max_ms / most_ms
    return [_bar(0, highest, opacity=0.3), _bar(0, median)]


def _bar(start: float, end: float, *, height: float = 1.0, opacity: float = 1.0) -> Bar:
    """A bar between two places of a strip; all numbers are shares."""
    return 100 * start, max(100 * (end - start), _LEAST_BAR), 100 * height, opacity
