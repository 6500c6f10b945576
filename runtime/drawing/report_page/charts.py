"""Charts of the report page as inline SVG; page.css has their colours."""

from collections.abc import Sequence
from html import escape

from runtime.drawing.axis import Axis, frame_ticks
from runtime.drawing.report_page.timeline import Span
from runtime.sync.latency import LatencyStatistics

LATE, SKIPPED, INVALID = "late", "skipped", "invalid"
_DROPS = (SKIPPED, INVALID)  # frames without a usable answer
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 14, 22, 34  # pixels
_SPAN_WIDTH, _POINT_WIDTH = 2, 7  # least pixels of a span, and of a span with a point
_STRIP = 1000  # units across a strip, which the page stretches


def latency_chart(
    spans: Sequence[Span], *, width: int, height: int, deadline_ms: float | None, title: str
) -> str:
    """Draw latencies over the frames, with the deadline, late frames, and frames without an answer.

    Where several frames share a span, a band shows the smallest and largest latency.

    Args:
        spans: of the frames, in order.
        width: pixels.
        height: pixels.
        deadline_ms: None = there is none.
        title: what the latencies are of.

    Returns:
        SVG; "" if no frame was answered.
    """
    answered = [span for span in spans if span.answered]
    if not answered:
        return ""
    means = sorted(span.mean_ms for span in answered)
    axis = Axis(
        min(span.low_ms for span in answered),
        means[len(means) // 2],
        max(span.high_ms for span in answered),
        deadline_ms,
    )
    last = max(spans[-1].last, 1)
    inner, bottom = width - _LEFT - _RIGHT, height - _BOTTOM

    def x(frame: float) -> float:
        return _LEFT + (frame / last if len(spans) > 1 else 0.5) * inner

    def y(value: float) -> float:
        return bottom - axis.place(value) * (bottom - _TOP)

    parts = [
        f'<svg class="chart w{width}" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{escape(title)} over the frames">'
    ]
    for tick in axis.ticks:
        parts.append(
            f'<line class="grid" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{y(tick):.1f}" '
            f'y2="{y(tick):.1f}"/><text x="{_LEFT - 8}" y="{y(tick) + 4:.1f}" '
            f'text-anchor="end">{tick:g}</text>'
        )
    parts.append(f'<text x="{_LEFT - 8}" y="12" text-anchor="start" dx="-40">{axis.unit}</text>')
    for frame in frame_ticks(last, inner // 90):
        anchor = "end" if frame == last and frame else "middle"
        parts.append(
            f'<text x="{x(frame):.1f}" y="{bottom + 18}" text-anchor="{anchor}">{frame}</text>'
        )
    parts.append(
        f'<text x="{_LEFT + inner / 2}" y="{height - 3}" text-anchor="middle">frame</text>'
    )
    for span in spans:
        if any(span.marks[drop] for drop in _DROPS):
            parts.append(_drop(span, x(span.middle), bottom))
    for run in _unbroken(spans):
        if any(span.answered > 1 for span in run):
            upper = [f"{x(span.middle):.1f},{y(span.high_ms):.1f}" for span in run]
            lower = [f"{x(span.middle):.1f},{y(span.low_ms):.1f}" for span in reversed(run)]
            parts.append(f'<polygon class="band" points="{" ".join(upper + lower)}"/>')
        line = " ".join(f"{x(span.middle):.1f},{y(span.mean_ms):.1f}" for span in run)
        parts.append(f'<polyline class="line" points="{line}"/>')
    if deadline_ms is not None:
        at = y(deadline_ms)
        parts.append(
            f'<line class="deadline" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{at:.1f}" '
            f'y2="{at:.1f}"/>'
        )
    sparse = len(spans) <= inner / _POINT_WIDTH
    for span in answered:
        late = span.marks[LATE]
        if not (sparse or late):
            continue
        at = y(span.high_ms if late else span.mean_ms)
        text = f"{span.name}: {span.mean_ms:.1f} ms" if span.frames == 1 else _of_several(span)
        parts.append(
            f'<circle class="{"late" if late else "point"}" cx="{x(span.middle):.1f}" '
            f'cy="{at:.1f}" r="{3.5 if late else 2.5}"><title>{escape(text)}</title></circle>'
        )
    return "".join([*parts, "</svg>"])


def spans_across(width: int) -> int:
    """Number of spans in a chart of this width."""
    return max((width - _LEFT - _RIGHT) // _SPAN_WIDTH, 1)


def mark_strip(spans: Sequence[Span], mark: str) -> str:
    """Draw where along the frames a mark occurs, without text: the page stretches it."""
    scale = _STRIP / (spans[-1].last + 1)
    blocks: list[list[float]] = []  # [from, to, share]
    for span in spans:
        if count := span.marks[mark]:
            share = count / span.frames
            if blocks and blocks[-1][1] == span.first and blocks[-1][2] == share:
                blocks[-1][1] = span.last + 1
            else:
                blocks.append([span.first, span.last + 1, share])
    drawn = "".join(
        f'<rect x="{start * scale:.2f}" y="0" width="{max((end - start) * scale, 2.5):.2f}" '
        f'height="10" fill-opacity="{0.6 + 0.4 * share:.2f}"/>'
        for start, end, share in blocks
    )
    return _strip(drawn, 10)


def returns_strip(spans: Sequence[Span]) -> str:
    """Draw the number of LiDAR returns of the frames."""
    scale = _STRIP / (spans[-1].last + 1)
    known = [(span, span.mean_returns) for span in spans if span.mean_returns is not None]
    most = max((returns for _, returns in known if returns is not None), default=0) or 1
    bars = "".join(
        f'<rect x="{span.first * scale:.2f}" y="{40 - 40 * (returns or 0) / most:.2f}" '
        f'width="{span.frames * scale + 0.3:.2f}" height="{40 * (returns or 0) / most:.2f}"/>'
        for span, returns in known
    )
    return _strip(bars, 40)


def range_strip(statistics: LatencyStatistics, most_ms: float) -> str:
    """Draw the latency of a stage: a bar to the median, a lighter one to the maximum."""
    median, highest = (
        _STRIP * value / most_ms for value in (statistics.median_ms, statistics.max_ms)
    )
    return _strip(
        f'<rect class="most" x="0" y="3" width="{highest:.1f}" height="4"/>'
        f'<rect x="0" y="0" width="{max(median, 2):.1f}" height="10"/>',
        10,
    )


def _strip(content: str, height: int) -> str:
    return (
        f'<svg class="strip" viewBox="0 0 {_STRIP} {height}" preserveAspectRatio="none" '
        f'aria-hidden="true">{content}</svg>'
    )


def _drop(span: Span, x: float, bottom: float) -> str:
    kinds = " ".join(drop for drop in _DROPS if span.marks[drop])
    where = span.name if span.frames == 1 else f"frames {span.first} to {span.last}"
    return (
        f'<g class="drop"><title>{escape(where)}: {kinds}</title>'
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{bottom}"/>'
        f'<path d="M{x - 4:.1f} {bottom - 9}l8 8m0 -8l-8 8"/></g>'
    )


def _of_several(span: Span) -> str:
    return (
        f"frames {span.first} to {span.last}: mean {span.mean_ms:.1f} ms, "
        f"max {span.high_ms:.1f} ms, {span.marks[LATE]} late"
    )


def _unbroken(spans: Sequence[Span]) -> list[list[Span]]:
    """Runs of answered spans, without gaps."""
    runs: list[list[Span]] = [[]]
    for span in spans:
        if span.answered:
            runs[-1].append(span)
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]
