"""The report page: HTML with inline charts and pictures, without external resources."""

import base64
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.drawing.report_page import charts
from runtime.drawing.report_page.samples import Sample
from runtime.drawing.report_page.template import render
from runtime.drawing.report_page.timeline import LATE, Span, Timeline
from runtime.io.encode import encode_png
from runtime.io.engine_facts import EngineFacts, ProviderFacts
from runtime.sync.frame_outcome import INVALID, SKIPPED
from runtime.sync.latency import LatencyStatistics, StreamStatistics

_PARTS = ("preprocess", "inference", "postprocess")  # of a prediction
_BAD = (*charts.DROPS, LATE)
_FEW_PROBLEMS, _MOST_PROBLEMS = 10, 200
_BAR_WIDTH = 640
_LIBRARIES = {"onnxruntime": "ONNX Runtime", "cv2": "OpenCV", "numpy": "NumPy"}
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


@dataclass(frozen=True, kw_only=True)
class PageContent:
    """The content of a page.

    Attributes:
        command: command line of the run; "" = none.
        interrupted: whether the run was stopped before its end.
        contract: of the model.
        engine: facts of model, provider and machine.
        timeline: outcomes of the frames.
        response: name of the latency that the chart shows and the deadline limits.
        responses: its statistics; None = no answer.
        statistics: of all stages.
        frames_per_second: None = not known.
        problems: name, status and reason of frames without a usable answer.
        samples: pictures.
        facts: name -> value; those that are None or empty are not shown.
    """

    command: str = ""
    interrupted: bool = False
    contract: Contract
    engine: EngineFacts
    timeline: Timeline
    response: str
    responses: LatencyStatistics | None
    statistics: StreamStatistics
    frames_per_second: float | None = None
    problems: Sequence[tuple[str, str, str]] = ()
    samples: Sequence[Sample]
    facts: Mapping[str, Any]


def render_page(content: PageContent) -> bytes:
    """Return the page, HTML in UTF-8 without external resources."""
    timeline = content.timeline
    spans = timeline.spans(charts.MOST_SPANS)
    dropped = {status: timeline.marks[status] for status in charts.DROPS}
    by_status = {"ok": timeline.frames - sum(dropped.values()), **dropped}
    values = {
        **vars(content),
        "by_status": ", ".join(f"{n:,} {status}" for status, n in by_status.items() if n) or "none",
        "highest": _highest_percentile(content.responses),
        "chart": charts.latency_chart(spans, deadline_ms=content.statistics.deadline_ms),
        "dropped": sum(dropped.values()),
        "stages": _stages(content.statistics.stages),
        "lanes": _lanes(timeline, spans),
        "last": timeline.frames - 1,
        "problems": _problems(content.problems),
        "samples": _samples(content),
        "facts": {name: fact for name, fact in content.facts.items() if fact not in (None, "")},
        "running": _running(content.engine.provider),
        "libraries": {
            name: library.__version__
            for module, name in _LIBRARIES.items()
            if (library := sys.modules.get(module))  # this process has loaded it
        },
    }
    # File names need not be valid text.
    return render("page.html", values).encode(errors="backslashreplace")


def _highest_percentile(times: LatencyStatistics | None) -> tuple[str, float] | None:
    """The highest percentile up to p99 that the number of frames supports, else the maximum."""
    if times is None:
        return None
    values = {"p99": times.p99_ms, "p90": times.p90_ms, "slowest": times.max_ms}
    return next((name, value) for name, value in values.items() if value is not None)


def _stages(statistics: Mapping[str, LatencyStatistics | None]) -> dict[str, Any]:
    stages = {name: each for name, each in statistics.items() if each is not None}
    most_ms = max((each.max_ms for each in stages.values()), default=0) or 1.0
    means = {name: stages[name].mean_ms for name in _PARTS if name in stages}
    sum_ms = sum(means.values()) or 1.0
    return {
        "parts": [(name, mean_ms, mean_ms / sum_ms) for name, mean_ms in means.items()],
        "rows": [(name, each, charts.range_strip(each, most_ms)) for name, each in stages.items()],
    }


def _lanes(timeline: Timeline, spans: Sequence[Span]) -> list[tuple[Any, ...]]:
    """Class, name, count, meaning and bars, the worst marks first, then the most frequent."""

    def rank(mark: str) -> tuple[int, int, str]:
        return (_BAD.index(mark) if mark in _BAD else len(_BAD)), -timeline.marks[mark], mark

    lanes = []
    for mark in sorted(timeline.marks, key=rank):
        kind = "bad" if mark in _BAD else "warn"
        count = f"{timeline.marks[mark]:,} of {timeline.frames:,}"
        bars = charts.mark_strip(spans, mark)
        lanes.append((kind, mark, count, _MEANINGS.get(mark, ""), bars))
    known = [span.mean_returns for span in spans if span.mean_returns is not None]
    if known:
        count = f"{min(known):,.0f} to {max(known):,.0f}"
        bars = charts.returns_strip(spans)
        lanes.append(("tall", "LiDAR returns", count, "used per frame", bars))
    return lanes


def _problems(problems: Sequence[tuple[str, str, str]]) -> dict[str, Any]:
    first, rest = problems[:_FEW_PROBLEMS], problems[_FEW_PROBLEMS:_MOST_PROBLEMS]
    beyond = max(len(problems) - _MOST_PROBLEMS, 0)
    return {"first": first, "rest": rest, "more": len(rest), "beyond": beyond}


def _samples(content: PageContent) -> dict[str, Any]:
    contract, samples, scale = content.contract, content.samples, ""
    if any("depth" in title for sample in samples for title, _ in sample.panels):
        bar = Overlay(contract.classes, contract.max_depth_m).draw_depth_bar(_BAR_WIDTH)
        scale = _data("image/png", bytes(encode_png(bar)))
    figures = [
        (sample, [(title, _data("image/jpeg", jpeg)) for title, jpeg in sample.panels])
        for sample in samples
    ]
    return {"figures": figures, "scale": scale}


def _running(provider: ProviderFacts) -> list[str]:
    nodes = provider.nodes or {}
    return [
        name + (f" ({nodes[name]} nodes)" if name in nodes else "") for name in provider.running
    ]


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
