"""Charts of the report page, for chart.html and strip.html: lengths in percent of the picture."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from runtime.drawing.report_page.axis import Axis, frame_ticks
from runtime.drawing.report_page.timeline import LATE, Span
from runtime.sync.frame_outcome import INVALID, SKIPPED
from runtime.sync.latency import LatencyStatistics

DROPS = (SKIPPED, INVALID)  # frames without a usable answer
MOST_SPANS = 490
_FRAME_TICKS = 6  # at most
_MOST_POINTS = 140  # a chart with more spans draws points for late spans only
_LEAST_BAR = 0.25  # percent of a strip

Bar = tuple[float, float, float, float]  # left, width, height, and opacity 0..1


def latency_chart(spans: Sequence[Span], *, deadline_ms: float | None) -> dict[str, Any]:
    """Latencies over the frames, with the deadline, late frames, and frames without an answer.

    Where several frames share a span, a band shows the smallest and largest latency.

    Args:
        spans: of the frames, in order.
        deadline_ms: None = there is none.

    Returns:
        The chart of chart.html; empty if no frame was answered.
    """
    answered = [span for span in spans if span.answered]
    if not answered:
        return {}
    means = sorted(span.mean_ms for span in answered)
    lowest, highest = min(span.low_ms for span in answered), max(span.high_ms for span in answered)
    axis = Axis(lowest, means[len(means) // 2], highest, deadline_ms)
    last = max(spans[-1].last, 1)

    def x(frame: float) -> float:
        return 100 * frame / last if len(spans) > 1 else 50.0

    def y(value_ms: float) -> float:
        return 100 * (1 - axis.place(value_ms))

    def path(places: Iterable[tuple[float, float]]) -> str:
        return " ".join(f"{x(frame):.2f},{y(value_ms):.2f}" for frame, value_ms in places)

    bands, lines, drops, points = [], [], [], []
    for is_answered, group in groupby(spans, lambda span: span.answered > 0):
        if is_answered:
            run = list(group)
            lines.append(path((span.middle, span.mean_ms) for span in run))
            above = [(span.middle, span.high_ms) for span in run]
            bands.append(path([*above, *((span.middle, span.low_ms) for span in reversed(run))]))
    for span in spans:
        if kinds := [drop for drop in DROPS if span.marks[drop]]:
            drops.append((x(span.middle), f"{_where(span)}: {' '.join(kinds)}"))
    for span in answered:
        if span.marks[LATE]:
            points.append((LATE, x(span.middle), y(span.high_ms), _latency(span)))
        elif len(spans) <= _MOST_POINTS:
            points.append(("point", x(span.middle), y(span.mean_ms), _latency(span)))
    return {
        "unit": axis.unit,
        "ticks": [(y(tick), tick) for tick in axis.ticks],
        "frames": [(x(frame), frame) for frame in frame_ticks(last, _FRAME_TICKS)],
        "joined": any(span.frames > 1 for span in spans),  # else the bands have no height
        "bands": bands,
        "lines": lines,
        "deadline": [] if deadline_ms is None else [y(deadline_ms)],
        "drops": drops,
        "points": points,
    }


def mark_strip(spans: Sequence[Span], mark: str) -> list[Bar]:
    """Where along the frames a mark occurs."""
    bars = []
    frames = spans[-1].last + 1
    for share, group in groupby(spans, lambda span: span.marks[mark] / span.frames):
        run = list(group)
        if share:
            start, end = run[0].first / frames, (run[-1].last + 1) / frames
            bars.append(_bar(start, end, opacity=0.6 + 0.4 * share))
    return bars


def returns_strip(spans: Sequence[Span]) -> list[Bar]:
    """The number of LiDAR returns of the frames."""
    frames = spans[-1].last + 1
    most = max(span.mean_returns or 0 for span in spans) or 1
    return [
        _bar(span.first / frames, (span.last + 1.03) / frames, height=span.mean_returns / most)
        for span in spans
        if span.mean_returns is not None
    ]


def range_strip(statistics: LatencyStatistics, most_ms: float) -> list[Bar]:
    """The latency of a stage: a bar to the median, a lighter one to the maximum."""
    median, highest = statistics.median_ms / most_ms, statistics.max_ms / most_ms
    return [_bar(0, highest, opacity=0.3), _bar(0, median)]


def _bar(start: float, end: float, *, height: float = 1.0, opacity: float = 1.0) -> Bar:
    return 100 * start, max(100 * (end - start), _LEAST_BAR), 100 * height, opacity


def _where(span: Span) -> str:
    return span.name if span.frames == 1 else f"frames {span.first} to {span.last}"


def _latency(span: Span) -> str:
    mean = f"{span.mean_ms:.1f} ms"
    if span.frames == 1:
        return f"{span.name}: {mean}"
    return f"{_where(span)}: mean {mean}, max {span.high_ms:.1f} ms, {span.marks[LATE]} late"
