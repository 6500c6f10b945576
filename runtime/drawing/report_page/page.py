"""The report page: HTML with inline charts and pictures, without external resources."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.drawing.report_page.charts import (
    INVALID,
    LATE,
    SKIPPED,
    latency_chart,
    mark_strip,
    range_strip,
    returns_strip,
    spans_across,
)
from runtime.drawing.report_page.samples import Sample
from runtime.drawing.report_page.timeline import Timeline
from runtime.io.encode import encode_png
from runtime.sync.latency import LatencyStatistics, MissedDeadlines

#: The page has the chart in each of these sizes and shows the one that fits the screen.
_CHARTS = ((1040, 300), (640, 270), (380, 230))
_PARTS = ("preprocess", "inference", "postprocess")  # of a prediction
_BAD = (SKIPPED, INVALID, LATE)
_FEW_PROBLEMS, _MOST_PROBLEMS = 10, 200
_BAR_WIDTH = 640
#: Mark -> its meaning.
_MEANINGS = {
    SKIPPED: "could not be read or predicted",
    INVALID: "the answer cannot be used",
    LATE: "later than the deadline",
    "no_depth": "no LiDAR return: camera only",
    "sparse_depth_low": "LiDAR returns in too few places",
    "implausible_depth": "the returns contradict the image",
    "image_constant": "all pixels are equal",
    "image_frozen": "same bytes as the image before",
    "image_black": "nearly all pixels are dark",
    "image_overexposed": "half of the pixels are saturated",
    "lidar_sector_lost": "a sector of the LiDAR is missing",
    "lidar_lines_lost": "scan lines of the LiDAR are missing",
}


@dataclass(frozen=True)
class Problem:
    """A frame without a usable answer."""

    name: str
    status: str
    reason: str


@dataclass(frozen=True)
class PageContent:
    """The content of a page.

    Attributes:
        title: heading.
        command: command line of the run; "" = none.
        interrupted: whether the run was stopped before its end.
        contract: of the model.
        timeline: outcomes of the frames.
        response: name of the latency that the chart shows and the deadline limits.
        responses: its statistics; None = no answer.
        stages: stage -> statistics.
        deadline_ms: None = there was none.
        missed: None = there was no deadline.
        frames: status -> frames.
        frames_per_second: None = not known.
        problems: frames without a usable answer.
        samples: pictures.
        facts: heading -> name -> value.
    """

    title: str
    command: str
    interrupted: bool
    contract: Contract
    timeline: Timeline
    response: str
    responses: LatencyStatistics | None
    stages: Mapping[str, LatencyStatistics | None]
    deadline_ms: float | None
    missed: MissedDeadlines | None
    frames: Mapping[str, int]
    frames_per_second: float | None
    problems: Sequence[Problem]
    samples: Sequence[Sample]
    facts: Mapping[str, Mapping[str, str]]


def render_page(content: PageContent) -> bytes:
    """Return the page, HTML in UTF-8 without external resources."""
    style = resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    badge = '<span class="badge warn">interrupted</span>' if content.interrupted else ""
    command = f'<code class="command">{escape(content.command)}</code>' if content.command else ""
    sections = [
        _latency(content),
        _stages(content),
        _health(content),
        _problems(content.problems),
        _samples(content),
        _facts(content.facts),
    ]
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # The browser then refuses to load anything.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">"
        f'<link rel="icon" href="data:,"><title>{escape(content.title)}: run report</title>'
        f"<style>{style}</style></head>\n<body><main>"
        f"<header><h1>{escape(content.title)} {badge}</h1>{command}</header>\n"
        + _tiles(content)
        + "\n".join(section for section in sections if section)
        + "</main></body></html>\n"
    )
    return page.encode(errors="backslashreplace")  # file names need not be valid text


def _tiles(content: PageContent) -> str:
    total = content.timeline.frames
    counts = ", ".join(f"{count:,} {status}" for status, count in content.frames.items())
    tiles = [("frames", f"{total:,}", counts or "none", "")]
    times = content.responses
    if times is not None:
        tiles.append((f"median {content.response}", f"{_ms(times.median_ms)} ms", "", ""))
        name, value = _highest_percentile(times)
        tiles.append((f"{name} {content.response}", f"{_ms(value)} ms", f"n = {times.n:,}", ""))
    if (missed := content.missed) is not None:
        note = f"deadline {content.deadline_ms:g} ms, longest run {missed.longest_run}"
        kind = "bad" if missed.count else "good"
        tiles.append(("missed deadlines", f"{missed.count:,}", note, kind))
    if content.frames_per_second is not None:
        rate = f"{content.frames_per_second:.1f}"
        tiles.append(("frames per second", rate, "reading and writing included", ""))
    flagged = content.timeline.flagged
    kind = "warn" if flagged else "good"
    tiles.append(("flagged frames", f"{flagged:,}", "late, unanswered or degraded", kind))
    return (
        '<div class="tiles">'
        + "".join(
            f'<div class="tile"><span>{escape(label)}</span><b class="{kind}">{escape(value)}</b>'
            f"<span>{escape(note)}</span></div>"
            for label, value, note, kind in tiles
        )
        + "</div>"
    )


def _latency(content: PageContent) -> str:
    charts = [
        latency_chart(
            content.timeline.spans(spans_across(width)),
            width=width,
            height=height,
            deadline_ms=content.deadline_ms,
            title=content.response,
        )
        for width, height in _CHARTS
    ]
    if not any(charts):
        return _section("Latency over time", '<p class="soft">No frame was answered.</p>')
    shared = len(content.timeline.spans(spans_across(_CHARTS[0][0]))) < content.timeline.frames
    marks = content.timeline.marks
    keys = ['<span class="key dot"></span>' + escape(content.response)]
    if shared:
        keys.append('<span class="key range"></span>smallest to largest of the frames there')
    if content.deadline_ms is not None:
        keys.append(f'<span class="key dash"></span>deadline {content.deadline_ms:g} ms')
    if marks[LATE]:
        keys.append(f'<span class="key dot red"></span>late ({marks[LATE]:,})')
    if dropped := marks[SKIPPED] + marks[INVALID]:
        keys.append(f'<span class="key cross">&times;</span>no usable answer ({dropped:,})')
    legend = "".join(f"<span>{key}</span>" for key in keys)
    return _section("Latency over time", "".join(charts) + f'<div class="legend">{legend}</div>')


def _stages(content: PageContent) -> str:
    stages = {name: each for name, each in content.stages.items() if each is not None}
    if not stages:
        return ""
    means = {name: stages[name].mean_ms for name in _PARTS if name in stages}
    whole = sum(means.values())
    bar = ""
    if whole:
        bar = (
            '<p class="note">Parts of a prediction, mean</p><div class="stack">'
            + "".join(
                f'<div class="{name}" style="width:{mean / whole:.2%}"></div>'
                for name, mean in means.items()
            )
            + '</div><div class="legend">'
            + "".join(
                f'<span><span class="key square {name}"></span>{name} {_ms(mean)} ms, '
                f"{mean / whole:.0%}</span>"
                for name, mean in means.items()
            )
            + "</div>"
        )
    most_ms = max(each.max_ms for each in stages.values()) or 1.0
    rows = "".join(
        f"<tr><td>{escape(name)}</td>"
        + "".join(f"<td>{cell}</td>" for cell in _cells(each))
        + f'<td class="wide">{range_strip(each, most_ms)}</td></tr>'
        for name, each in stages.items()
    )
    heads = "".join(
        f"<th>{name}</th>"
        for name in ("stage, ms", "n", "mean", "median", "p90", "p99", "p99.9", "max")
    )
    table = (
        f'<div class="scroll"><table><thead><tr>{heads}<th class="wide"></th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
        '<p class="note">A percentile needs enough frames beyond it: p99 is shown from 100 '
        "frames on. Reading and writing run in parallel with the prediction. Bars: median and "
        "maximum.</p>"
    )
    return _section("Percentiles and stages", bar + table)


def _health(content: PageContent) -> str:
    timeline = content.timeline
    spans = timeline.spans(500)
    lanes = []
    for mark, count in sorted(timeline.marks.items(), key=lambda item: _rank(*item)):
        kind = "bad" if mark in _BAD else "warn"
        meaning = f"<small>{escape(_MEANINGS[mark])}</small>" if mark in _MEANINGS else ""
        lanes.append(
            f'<div class="lane {kind}"><div><b>{escape(mark)}</b> <span class="count">{count:,} '
            f"of {timeline.frames:,}</span>{meaning}</div>{mark_strip(spans, mark)}</div>"
        )
    known = [span.mean_returns for span in spans if span.mean_returns is not None]
    if not lanes and timeline.frames:
        lanes.append('<p class="good">All frames were answered, none is flagged.</p>')
    if known:
        least, most = min(known), max(known)
        lanes.append(
            '<div class="lane"><div><b>LiDAR returns</b> <span class="count">'
            f"{least:,.0f} to {most:,.0f}</span><small>used per frame</small></div>"
            f'<div class="tall">{returns_strip(spans)}</div></div>'
        )
    if not lanes:
        return ""
    last = f"{timeline.frames - 1:,}"
    lanes.append(f'<p class="note">From frame 0 (left) to {last} (right).</p>')
    return _section("Health over time", "".join(lanes))


def _problems(problems: Sequence[Problem]) -> str:
    if not problems:
        return ""
    shown = _problem_table(problems[:_FEW_PROBLEMS])
    if rest := problems[_FEW_PROBLEMS:_MOST_PROBLEMS]:
        shown += f"<details><summary>{len(rest)} more</summary>{_problem_table(rest)}</details>"
    if (beyond := len(problems) - _MOST_PROBLEMS) > 0:
        shown += f'<p class="note">and {beyond:,} more, see frames.csv</p>'
    return _section("Frames without an answer", shown)


def _problem_table(problems: Sequence[Problem]) -> str:
    rows = "".join(
        f"<tr><td>{escape(each.name)}</td><td>{escape(each.status)}</td>"
        f"<td>{escape(each.reason)}</td></tr>"
        for each in problems
    )
    return (
        '<div class="scroll"><table class="problems"><thead><tr><th>frame</th><th>status</th>'
        f"<th>why</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _samples(content: PageContent) -> str:
    if not content.samples:
        return ""
    figures = []
    for sample in content.samples:
        badges = ['<span class="badge">slowest</span>'] if sample.slowest else []
        badges += [f'<span class="badge warn">{escape(mark)}</span>' for mark in sample.marks]
        panels = "".join(
            f'<div><span>{escape(title)}</span><img alt="{escape(title)} of {escape(sample.name)}" '
            f'src="{_data("image/jpeg", jpeg)}"></div>'
            for title, jpeg in sample.panels
        )
        count = {1: "one", 2: "two"}.get(len(sample.panels), "")
        figures.append(
            f'<figure><figcaption><b>{escape(sample.name)}</b> <span class="count">predicted in '
            f"{_ms(sample.predict_ms)} ms</span> {' '.join(badges)}</figcaption>"
            f'<div class="panels {count}">{panels}</div></figure>'
        )
    contract = content.contract
    chips = "".join(
        f'<span><span class="key square" style="background:rgb{info.color}"></span>'
        f"{escape(info.name)}</span>"
        for info in contract.classes
    )
    bar = Overlay(contract.classes, contract.max_depth_m).draw_depth_bar(_BAR_WIDTH)
    png = bytes(encode_png(bar))
    key = f'<div class="legend">{chips}</div>' if chips else ""
    if any("depth" in title for sample in content.samples for title, _ in sample.panels):
        scale = f'<img alt="colour scale of the depth" src="{_data("image/png", png)}">'
        key += f'<div class="bar">{scale}</div>'
    return _section("Samples", "".join(figures) + key)


def _facts(facts: Mapping[str, Mapping[str, str]]) -> str:
    groups = "".join(
        f"<div><h3>{escape(heading)}</h3><dl>"
        + "".join(
            f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in group.items()
        )
        + "</dl></div>"
        for heading, group in facts.items()
    )
    return _section("Facts", f'<div class="facts">{groups}</div>')


def _section(title: str, content: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{content}</section>"


def _rank(mark: str, count: int) -> tuple[int, int, str]:
    """Sort key: the worst marks first, then the most frequent."""
    return (_BAD.index(mark) if mark in _BAD else len(_BAD)), -count, mark


def _highest_percentile(times: LatencyStatistics) -> tuple[str, float]:
    """The highest percentile up to p99 that the number of frames supports, else the maximum."""
    for name, value in (("p99", times.p99_ms), ("p90", times.p90_ms)):
        if value is not None:
            return name, value
    return "slowest", times.max_ms


def _cells(times: LatencyStatistics) -> list[str]:
    values = (
        times.mean_ms,
        times.median_ms,
        times.p90_ms,
        times.p99_ms,
        times.p99_9_ms,
        times.max_ms,
    )
    return [f"{times.n:,}", *("n/a" if value is None else _ms(value) for value in values)]


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:,.0f}"


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
