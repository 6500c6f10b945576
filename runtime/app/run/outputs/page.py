"""The page of --report: HTML with inline charts and pictures, without external resources."""

import base64
import contextlib
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.app.run.engine_facts import running_providers
from runtime.app.run.frame_record import LATE, REASONS
from runtime.app.run.outages import Outage
from runtime.app.run.outputs import charts
from runtime.app.run.outputs.run_context import RunContext
from runtime.app.run.run_report import RunReport
from runtime.command.html import render_template
from runtime.command.machine import machine_facts
from runtime.contract.contract import Contract
from runtime.drawing.encode import encode_jpeg, encode_png
from runtime.drawing.overlay import Overlay
from runtime.files.atomic_write import atomic_write
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult
from runtime.streams.statistics import LatencyStatistics

_WORST_MARKS = (*charts.UNANSWERED, LATE)
_MOST_OUTAGES = 4  # outages that are listed for a reason
_MOST_PROBLEMS = 200  # frames that are listed
_EVEN_SAMPLES = 6  # at most so many samples at equal distances
_MARKED_SAMPLES = 4  # at most so many samples whose marks no earlier sample has
_SAMPLE_PANELS, _PANEL_WIDTH = 3, 480  # the image and the first two heads
_JPEG_QUALITY = 82
_DEPTH_BAR_WIDTH = 640


@dataclass(frozen=True)
class Sample:
    """A frame whose pictures the page shows, with (title, data address) of each panel."""

    index: int
    name: str
    predict_ms: float
    marks: tuple[str, ...]
    panels: tuple[tuple[str, str], ...]
    slowest: bool = False


class RunPage:
    """Collects the samples of a run of so many frames, and makes its page; see `open_page`."""

    def __init__(self, contract: Contract, frames: int) -> None:
        self._contract = contract
        self._overlay = Overlay(contract.classes, contract.max_depth_m)
        self._started = datetime.now(UTC)
        self._step, self._frames = -(-frames // _EVEN_SAMPLES) or 1, 0
        self._samples: dict[int, Sample] = {}  # by the number of the frame
        self._slowest: Sample | None = None

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Keep the pictures of a frame if it is a sample."""
        index, self._frames = self._frames, self._frames + 1
        prediction = result.prediction
        marks = (*prediction.degraded, *result.health)
        time_ms = prediction.latency.total_ms
        is_slowest = self._slowest is None or time_ms > self._slowest.predict_ms
        known = {sample.marks for sample in self._samples.values()}
        has_new_marks = bool(marks) and marks not in known and len(known) < _MARKED_SAMPLES
        is_sample = index % self._step == 0 or has_new_marks
        if not (is_sample or is_slowest):
            return
        drawn = self._overlay.panels(frame.rgb, prediction, frame.sparse_depth, widest=_PANEL_WIDTH)
        panels = tuple(
            (title, _data("image/jpeg", encode_jpeg(panel, quality=_JPEG_QUALITY)))
            for title, panel in list(drawn.items())[:_SAMPLE_PANELS]
        )
        sample = Sample(index, frame.name, time_ms, marks, panels)
        if is_slowest:
            self._slowest = sample
        if is_sample:
            self._samples[index] = sample

    def samples(self) -> list[Sample]:
        """The samples, in the order of the frames."""
        samples = dict(self._samples)
        if self._slowest is not None:
            samples[self._slowest.index] = replace(self._slowest, slowest=self._frames > 1)
        return [samples[index] for index in sorted(samples)]

    def render(self, report: RunReport) -> bytes:
        """Return the page, HTML in UTF-8 without external resources."""
        records, statistics = report.records, report.statistics
        names = [each.name for each in records]
        times_s = None if report.timeline is None else report.timeline.times_s
        ends_s = [each.end_s for each in report.outages if each.end_s is not None]
        axis = charts.Axis.of(len(records), times_s, max(ends_s, default=0.0))
        spans = charts.group_frames(records, axis)
        marks = [charts.frame_marks(record) for record in records]
        counts = Counter(mark for each in marks for mark in each)
        is_stream, provider = report.options.rate is not None, report.engine["provider"]
        responses = statistics.stages.get("age" if is_stream else "predict")
        values = {
            "report": report,
            "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            "contract": self._contract,
            "marks": counts,
            "flagged": sum(map(bool, marks)),
            "response": "age" if is_stream else "prediction",
            "responses": responses,
            "highest": responses and _highest_percentile(responses),
            "chart": charts.latency_chart(spans, axis, deadline_ms=statistics.deadline_ms),
            "lanes": [*_outage_lanes(report.outages, axis), *_lanes(counts, spans)],
            "axis": axis,
            "times_s": {} if times_s is None else dict(zip(names, times_s, strict=True)),
            "most_problems": _MOST_PROBLEMS,
            "samples": self.samples(),
            "depth_scale": _data(
                "image/png", encode_png(self._overlay.draw_depth_bar(_DEPTH_BAR_WIDTH))
            ),
            "facts": _facts(report, self._started),
            "running": running_providers(provider["running"], provider["nodes"]),
            "processor": machine_facts().processor,
        }
        text = render_template("runtime.app.run.outputs", "page.html", values)
        return text.encode(errors="backslashreplace")  # file names need not be valid text


@contextlib.contextmanager
def open_page(run: RunContext) -> Iterator[RunPage]:
    """Make the page of --report, written when the block ends."""
    assert run.options.page is not None
    page = RunPage(run.predictor.contract, len(run.names))
    yield page
    content = page.render(run.report)
    atomic_write(run.options.page, content, overwrite=run.options.overwrite)


def _highest_percentile(times: LatencyStatistics) -> tuple[str, float]:
    """The highest percentile, up to p99, that the number of frames supports, else the maximum."""
    values = {"p99": times.p99_ms, "p90": times.p90_ms, "slowest": times.max_ms}
    return next((name, value) for name, value in values.items() if value is not None)


def _outage_lanes(outages: Sequence[Outage], axis: charts.Axis) -> Iterator[tuple[Any, ...]]:
    """A lane, see `_lanes`, for each reason for which a sensor was out."""
    for reason in dict.fromkeys(each.reason for each in outages):
        same_reason = [each for each in outages if each.reason == reason]
        listed = "; ".join(each.text for each in same_reason[:_MOST_OUTAGES])
        if len(same_reason) > _MOST_OUTAGES:
            listed += f" and {len(same_reason) - _MOST_OUTAGES} more"
        times_s = [(each.start_s, each.end_s) for each in same_reason]
        strip = [
            charts.bar(axis.percent(start), axis.percent(max(end, start + axis.period)))
            for start, end in times_s
            if start is not None and end is not None
        ]
        yield "bad", listed, "", REASONS[reason], strip


def _lanes(marks: Counter[str], spans: Sequence[charts.Span]) -> Iterator[tuple[Any, ...]]:
    """Class, name, count, meaning and bars of each lane of "Health over time".

    The worst marks come first, then the most frequent ones.
    """
    frames = sum(span.frames for span in spans)
    for mark in sorted(marks, key=lambda mark: (mark not in _WORST_MARKS, -marks[mark], mark)):
        kind, count = "bad" if mark in _WORST_MARKS else "warn", f"{marks[mark]:,} of {frames:,}"
        yield kind, mark, count, REASONS.get(mark, ""), charts.mark_strip(spans, mark)
    means = [span.mean_returns for span in spans if span.mean_returns is not None]
    if means:
        count = f"{min(means):,.0f} to {max(means):,.0f}"
        meaning = "in a frame, before it is resized"
        yield "tall", "LiDAR returns", count, meaning, charts.returns_strip(spans)


def _facts(report: RunReport, started: datetime) -> dict[str, Any]:
    rate_hz, sizes = report.options.rate, report.by_network_size.items()
    facts = {
        "started": f"{started:%Y-%m-%d %H:%M:%S} UTC",
        "took": f"{report.stream.wall_s:.1f} s",
        "scenario": report.scenario + (f", {rate_hz:g} Hz" if rate_hz else ""),
        **{name.replace("_", " "): value for name, value in report.inputs.items()},
        "network ran at": ", ".join(f"{size} ({count})" for size, count in sizes),
        "depth": ", ".join(f"{kind} ({count})" for kind, count in report.depth_sources.items()),
        "findings": "; ".join(each.line for each in report.findings),
        "readings": "; ".join(
            f"{camera}: {judged.text}" if camera else judged.text
            for camera, judged in report.judgements.items()
            if judged.frames
        ),
        "output": report.out,
        "saved": ", ".join(report.saved) or "nothing",
    }
    return {name: fact for name, fact in facts.items() if fact not in (None, "")}


def _data(kind: str, content: bytes | memoryview) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
