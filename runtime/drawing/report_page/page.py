"""The report page: HTML with inline charts and pictures, without external resources."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.drawing.report_page.charts import (
    INVALID,
    LATE,
    MOST_SPANS,
    SKIPPED,
    latency_chart,
    mark_strip,
    range_strip,
    returns_strip,
)
from runtime.drawing.report_page.html import Html, fill, read_resource
from runtime.drawing.report_page.samples import Sample
from runtime.drawing.report_page.timeline import Timeline
from runtime.io.encode import encode_png
from runtime.sync.latency import LatencyStatistics, MissedDeadlines

_PARTS = ("preprocess", "inference", "postprocess")  # of a prediction
_BAD = (SKIPPED, INVALID, LATE)
_FEW_PROBLEMS, _MOST_PROBLEMS = 10, 200
_BAR_WIDTH = 640
_TILE = ("label", "value", "note", "kind")
#: Mark -> its meaning.
_MEANINGS = {
    SKIPPED: "could not be read or predicted",
    INVALID: "the answer cannot be used",
    LATE: "later than the deadline",
    "no_depth": "no LiDAR return: camera only",
    "sparse_depth_low": "LiDAR returns in too few places",
    "depth_reused": "returns of an older scan",
    "depth_uncompensated": "returns not at the time of the image",
    "no_pose": "no pose at the time of scan or image",
    "pose_gap": "too long without a pose",
    "pose_jump": "the odometry jumped",
    "pose_clock": "poses of another clock",
    "implausible_depth": "the returns contradict the image",
    "image_constant": "all pixels are equal",
    "image_frozen": "same bytes as the image before",
    "image_black": "nearly all pixels are dark",
    "image_overexposed": "half of the pixels are saturated",
    "lidar_sector_lost": "a sector of the LiDAR is missing",
    "lidar_lines_lost": "scan lines of the LiDAR are missing",
}


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
        problems: name, status and reason of frames without a usable answer.
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
    problems: Sequence[tuple[str, str, str]]
    samples: Sequence[Sample]
    facts: Mapping[str, Mapping[str, str]]


def render_page(content: PageContent) -> bytes:
    """Return the page, HTML in UTF-8 without external resources."""
    sections = {
        "Latency over time": _latency(content),
        "Percentiles and stages": _stages(content),
        "Health over time": _health(content),
        "Frames without an answer": _problems(content.problems),
        "Samples": _samples(content),
        "Facts": _facts(content.facts),
    }
    page = fill(
        "page",
        title=content.title,
        style=Html(read_resource("page.css")),
        badges=fill("badge", kind="warn", text="interrupted") if content.interrupted else "",
        command=fill("command", command=content.command) if content.command else "",
        tiles=_tiles(content),
        sections=[
            fill("section", title=title, content=part) for title, part in sections.items() if part
        ],
    )
    return (page + "\n").encode(errors="backslashreplace")  # file names need not be valid text


def _tiles(content: PageContent) -> list[Html]:
    counts = ", ".join(f"{count:,} {status}" for status, count in content.frames.items())
    tiles = [("frames", f"{content.timeline.frames:,}", counts or "none", "")]
    if (times := content.responses) is not None:
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
    return [fill("tile", **dict(zip(_TILE, tile, strict=True))) for tile in tiles]


def _latency(content: PageContent) -> list[Html]:
    timeline, deadline_ms = content.timeline, content.deadline_ms
    spans = timeline.spans(MOST_SPANS)
    chart = latency_chart(spans, deadline_ms=deadline_ms, title=content.response)
    if not chart:
        return [fill("note", kind="soft", text="No frame was answered.")]
    keys = {"dot": content.response}
    if len(spans) < timeline.frames:
        keys["range"] = "smallest to largest of the frames there"
    if deadline_ms is not None:
        keys["dash"] = f"deadline {deadline_ms:g} ms"
    if late := timeline.marks[LATE]:
        keys["dot red"] = f"late ({late:,})"
    if dropped := timeline.marks[SKIPPED] + timeline.marks[INVALID]:
        keys["dot warn"] = f"no usable answer ({dropped:,})"
    return [chart, fill("legend", keys=_keys(keys))]


def _stages(content: PageContent) -> list[Html]:
    stages = {name: each for name, each in content.stages.items() if each is not None}
    if not stages:
        return []
    means = {name: stages[name].mean_ms for name in _PARTS if name in stages}
    shares = {name: mean / (sum(means.values()) or 1) for name, mean in means.items()}
    keys = {f"square {name}": f"{name} {_ms(means[name])} ms, {shares[name]:.0%}" for name in means}
    bars = [fill("part", kind=name, share=f"{share:.2%}") for name, share in shares.items()]
    parts = [fill("parts", bars=bars, keys=_keys(keys))] if means else []
    most_ms = max(each.max_ms for each in stages.values()) or 1.0
    rows = [
        _row(name, *_cells(each), last=fill("wide", strip=range_strip(each, most_ms)))
        for name, each in stages.items()
    ]
    return [*parts, fill("stages", rows=rows)]


def _health(content: PageContent) -> list[Html]:
    timeline = content.timeline
    spans = timeline.spans(MOST_SPANS)
    lanes = [
        fill(
            "lane",
            kind="bad" if mark in _BAD else "warn",
            name=mark,
            count=f"{count:,} of {timeline.frames:,}",
            meaning=_MEANINGS.get(mark, ""),
            strip=mark_strip(spans, mark),
        )
        for mark, count in sorted(timeline.marks.items(), key=lambda item: _rank(*item))
    ]
    if not lanes and timeline.frames:
        text = "All frames were answered, none is flagged."
        lanes.append(fill("note", kind="good", text=text))
    known = [span.mean_returns for span in spans if span.mean_returns is not None]
    if known:
        count = f"{min(known):,.0f} to {max(known):,.0f}"
        lane = {"name": "LiDAR returns", "count": count, "meaning": "used per frame"}
        lanes.append(fill("lane", kind="tall", strip=returns_strip(spans), **lane))
    if lanes:
        text = f"From frame 0 (left) to {timeline.frames - 1:,} (right)."
        lanes.append(fill("note", kind="note", text=text))
    return lanes


def _problems(problems: Sequence[tuple[str, str, str]]) -> list[Html]:
    def table(shown: Sequence[tuple[str, str, str]]) -> Html:
        return fill("problems", rows=[_row(*each) for each in shown])

    parts = [table(problems[:_FEW_PROBLEMS])] if problems else []
    if rest := problems[_FEW_PROBLEMS:_MOST_PROBLEMS]:
        parts.append(fill("more", count=len(rest), table=table(rest)))
    if (beyond := len(problems) - _MOST_PROBLEMS) > 0:
        parts.append(fill("note", kind="note", text=f"and {beyond:,} more, see frames.csv"))
    return parts


def _samples(content: PageContent) -> list[Html]:
    parts = []
    for sample in content.samples:
        badges = [fill("badge", kind="", text="slowest")] if sample.slowest else []
        badges += [fill("badge", kind="warn", text=mark) for mark in sample.marks]
        panels = [
            fill("panel", title=title, name=sample.name, image=_data("image/jpeg", jpeg))
            for title, jpeg in sample.panels
        ]
        time = _ms(sample.predict_ms)
        parts.append(fill("sample", name=sample.name, time=time, badges=badges, panels=panels))
    contract = content.contract
    if parts and contract.classes:
        keys = [fill("swatch", color=info.color, name=info.name) for info in contract.classes]
        parts.append(fill("legend", keys=keys))
    if any("depth" in title for sample in content.samples for title, _ in sample.panels):
        bar = Overlay(contract.classes, contract.max_depth_m).draw_depth_bar(_BAR_WIDTH)
        parts.append(fill("scale", image=_data("image/png", bytes(encode_png(bar)))))
    return parts


def _facts(facts: Mapping[str, Mapping[str, str]]) -> Html:
    groups = []
    for title, group in facts.items():
        rows = [fill("fact", name=name, value=value) for name, value in group.items()]
        groups.append(fill("group", title=title, facts=rows))
    return fill("facts", groups=groups)


def _row(*cells: str, last: Html | None = None) -> Html:
    return fill("row", cells=[*(fill("cell", text=cell) for cell in cells), last or Html()])


def _keys(keys: Mapping[str, str]) -> list[Html]:
    return [fill("key", kind=kind, text=text) for kind, text in keys.items()]


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
    n, *values = astuple(times)
    return [f"{n:,}", *("n/a" if value is None else _ms(value) for value in values)]


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:,.0f}"


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
