"""Charts of the page, filled in by chart.html and strip.html; lengths in percent of a chart."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

from runtime.streams.frame_result import INVALID, OK, SKIPPED, FrameResult

UNANSWERED = (SKIPPED, INVALID)  # frames without a usable answer
LATE = "late"
_MOST_SPANS = 490  # of a chart
_MOST_FRAME_TICKS = 6
_MOST_POINTS = 140  # a chart with more spans draws points for late ones only
_LEAST_BAR = 0.25  # width of a bar in percent of its strip

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
    def slowest_ms(self) -> float:
        """Largest latency of the answered frames, of which there are some."""
        return max(self.times_ms)

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


def latency_chart(spans: Sequence[Span], *, deadline_ms: float | None) -> dict[str, Any]:
    """Draw the latency of the slowest frame of each span, the deadline, and unanswered frames.

    Returns the values of chart.html; {} if no frame was answered.
    """
    answered = [span for span in spans if span.times_ms]
    if not answered:
        return {}
    limits = [] if deadline_ms is None else [deadline_ms]
    highest = max([*limits, *(span.slowest_ms for span in answered)])
    step, last = _distance(highest / 5), max(spans[-1].last, 1)
    top = step * max(math.ceil(highest / step), 1)

    def x(frame: float) -> float:
        return 100 * frame / last if len(spans) > 1 else 50.0

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
        "frames": [
            (x(frame), frame)
            for frame in range(0, last + 1, round(_distance(max(last / _MOST_FRAME_TICKS, 1))))
        ],
        "joined": any(len(span.records) > 1 for span in spans),
        "lines": [
            " ".join(f"{x(span.middle):.2f},{y(span.slowest_ms):.2f}" for span in run)
            for is_answered, run in groupby(spans, lambda span: bool(span.times_ms))
            if is_answered
        ],
        "deadline": [y(limit) for limit in limits],
        "unanswered": [
            (x(span.middle), f"{span.title}: {' '.join(kinds)}")
            for span in spans
            if (kinds := [mark for mark in UNANSWERED if span.marks[mark]])
        ],
        "points": points,
    }


def _distance(least: float) -> float:
    """The distance of ticks: 1, 2 or 5 of a power of ten, and not below `least`."""
    steps = (step * 10.0**power for power in range(-6, 10) for step in (1, 2, 5))
    return next(step for step in steps if step >= least)


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


def _bar(start: float, end: float, *, height: float = 1.0, opacity: float = 1.0) -> Bar:
    """A bar between two places of a strip; all numbers are shares."""
    return 100 * start, max(100 * (end - start), _LEAST_BAR), 100 * height, opacity
