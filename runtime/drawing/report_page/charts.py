"""Charts of the report page: SVG that stretches with the page; page.css has their colours."""

from collections.abc import Iterable, Sequence
from itertools import groupby

from runtime.drawing.axis import Axis, frame_ticks
from runtime.drawing.report_page.html import Html, fill
from runtime.drawing.report_page.timeline import Span
from runtime.sync.latency import LatencyStatistics

LATE, SKIPPED, INVALID = "late", "skipped", "invalid"
_DROPS = (SKIPPED, INVALID)  # frames without a usable answer
_WIDTH, _HEIGHT = 1000, 300  # units of the chart
_FRAME_TICKS = 6  # at most
_MOST_POINTS = 140  # spans of a chart; of more only the late ones have a point
_LEAST_BAR = 0.0025  # of a strip
MOST_SPANS = 490

Bar = tuple[float, float, float, float]  # from, to, height and opacity, 0..1 each


def latency_chart(spans: Sequence[Span], *, deadline_ms: float | None, title: str) -> Html:
    """Draw latencies over the frames, with the deadline, late frames, and frames without an answer.

    Where several frames share a span, a band shows the smallest and largest latency.

    Args:
        spans: of the frames, in order.
        deadline_ms: None = there is none.
        title: what the latencies are of.

    Returns:
        An element of the page's width; "" if no frame was answered.
    """
    answered = [span for span in spans if span.answered]
    if not answered:
        return Html()
    means = sorted(span.mean_ms for span in answered)
    lowest, highest = min(span.low_ms for span in answered), max(span.high_ms for span in answered)
    axis = Axis(lowest, means[len(means) // 2], highest, deadline_ms)
    last = max(spans[-1].last, 1)

    def x(frame: float) -> float:
        return round(_WIDTH * (frame / last if len(spans) > 1 else 0.5), 1)

    def y(value_ms: float) -> float:
        return round(_HEIGHT * (1 - axis.place(value_ms)), 1)

    drawn = [fill("gridline", kind="grid", y=y(tick)) for tick in axis.ticks]
    for span in spans:
        if kinds := [drop for drop in _DROPS if span.marks[drop]]:
            where = span.name if span.frames == 1 else f"frames {span.first} to {span.last}"
            drawn.append(fill("drop", x=x(span.middle), text=f"{where}: {' '.join(kinds)}"))
    for is_answered, group in groupby(spans, lambda span: span.answered > 0):
        if not is_answered:
            continue
        run = list(group)
        if any(span.answered > 1 for span in run):
            band = [(x(span.middle), y(span.high_ms)) for span in run]
            band += [(x(span.middle), y(span.low_ms)) for span in reversed(run)]
            drawn.append(fill("band", points=_points(band)))
        line = _points((x(span.middle), y(span.mean_ms)) for span in run)
        drawn.append(fill("line", points=line))
    if deadline_ms is not None:
        drawn.append(fill("gridline", kind="deadline", y=y(deadline_ms)))
    for span in answered:
        late = span.marks[LATE]
        if late or len(spans) <= _MOST_POINTS:
            text = f"{span.name}: {span.mean_ms:.1f} ms" if span.frames == 1 else _of_several(span)
            at = y(span.high_ms if late else span.mean_ms)
            kind = LATE if late else "point"
            drawn.append(fill("point", kind=kind, x=x(span.middle), y=at, text=text))
    ticks = [fill("ytick", at=100 * axis.place(tick), text=f"{tick:g}") for tick in axis.ticks]
    for frame in frame_ticks(last, _FRAME_TICKS):
        ticks.append(fill("xtick", at=x(frame) * 100 / _WIDTH, text=frame))
    return fill("chart", title=title, unit=axis.unit, drawn=drawn, ticks=ticks)


def mark_strip(spans: Sequence[Span], mark: str) -> Html:
    """Draw where along the frames a mark occurs."""
    bars: list[Bar] = []
    frames = spans[-1].last + 1
    for share, group in groupby(spans, lambda span: span.marks[mark] / span.frames):
        run = list(group)
        if share:
            start, end = run[0].first / frames, (run[-1].last + 1) / frames
            bars.append((start, end, 1.0, 0.6 + 0.4 * share))
    return _strip(bars)


def returns_strip(spans: Sequence[Span]) -> Html:
    """Draw the number of LiDAR returns of the frames."""
    frames = spans[-1].last + 1
    most = max((span.mean_returns or 0 for span in spans), default=0) or 1
    return _strip(
        (span.first / frames, (span.last + 1.03) / frames, span.mean_returns / most, 1.0)
        for span in spans
        if span.mean_returns is not None
    )


def range_strip(statistics: LatencyStatistics, most_ms: float) -> Html:
    """Draw the latency of a stage: a bar to the median, a lighter one to the maximum."""
    median, highest = statistics.median_ms / most_ms, statistics.max_ms / most_ms
    return _strip([(0, highest, 1.0, 0.3), (0, median, 1.0, 1.0)])


def _strip(bars: Iterable[Bar]) -> Html:
    drawn = [
        fill(
            "bar",
            x=round(1000 * start, 2),
            width=round(1000 * max(end - start, _LEAST_BAR), 2),
            y=round(100 - 100 * height, 2),
            height=round(100 * height, 2),
            opacity=round(opacity, 2),
        )
        for start, end, height, opacity in bars
    ]
    return fill("strip", bars=drawn)


def _points(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x},{y}" for x, y in points)


def _of_several(span: Span) -> str:
    return (
        f"frames {span.first} to {span.last}: mean {span.mean_ms:.1f} ms, "
        f"max {span.high_ms:.1f} ms, {span.marks[LATE]} late"
    )
