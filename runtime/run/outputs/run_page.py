"""The page of a run over a stream of frames."""

import contextlib
import shlex
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.contract import Contract
from runtime.drawing.report_page.samples import SampleKeeper
from runtime.drawing.report_page.timeline import Timeline
from runtime.io.atomic_write import atomic_write
from runtime.prediction import Prediction
from runtime.run.outputs.output import OpenRun
from runtime.run.run_report import RunReport
from runtime.sources.frames import Frame


class RunPage:
    """Keeps sample pictures of a run, and makes its page; see `open_page`."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._started = datetime.now(UTC)
        self._samples = SampleKeeper(contract)

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Keep a frame and its answer as a sample, perhaps; nothing is written yet."""
        self._samples.add(frame.name, frame.rgb, prediction, frame.health)

    def render(self, report: RunReport) -> bytes:
        """Return the page."""
        from runtime.drawing.report_page.page import PageContent, render_page

        timeline = Timeline()
        for record in report.records:
            timeline.add(record)
        single, statistics = report.stream.rate_hz is None, report.statistics
        content = PageContent(
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            interrupted=report.stream.interrupted,
            contract=self._contract,
            engine=report.engine,
            timeline=timeline,
            response="prediction" if single else "age",
            responses=statistics.stages["predict" if single else "age"],
            statistics=statistics,
            frames_per_second=report.frames_per_second,
            problems=[(each.name, each.status, each.reason) for each in report.not_ok],
            samples=self._samples.samples(),
            facts=_run_facts(report, self._started),
        )
        return render_page(content)


@contextlib.contextmanager
def open_page(run: OpenRun) -> Iterator[RunPage]:
    """Make the page of --report, written when the block ends."""
    assert run.options.report is not None
    page = RunPage(run.predictor.contract)
    yield page
    if run.report is not None:
        content = page.render(run.report)
        atomic_write(run.options.report, content, overwrite=run.options.overwrite)


def _run_facts(report: RunReport, started: datetime) -> dict[str, Any]:
    rate_hz, sizes = report.stream.rate_hz, report.by_network_size.items()
    return {
        "started": f"{started:%Y-%m-%d %H:%M:%S} UTC",
        "took": f"{report.stream.wall_s:.1f} s",
        "scenario": report.scenario + (f", {rate_hz:g} Hz" if rate_hz else ""),
        **{name.replace("_", " "): value for name, value in report.inputs.items()},
        "network ran at": ", ".join(f"{size} ({count})" for size, count in sizes),
        "depth": ", ".join(f"{kind} ({count})" for kind, count in report.depth_sources.items()),
        "implausible depth": report.implausible_depth,
        "output": report.out,
        "saved": ", ".join(report.saved) or "nothing",
    }
