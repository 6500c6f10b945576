"""The page of a run over a stream of frames."""

import shlex
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.contract import Contract
from runtime.drawing.report_page.charts import LATE
from runtime.drawing.report_page.facts import collect_facts
from runtime.drawing.report_page.page import PageContent, Problem, render_page
from runtime.drawing.report_page.samples import SampleKeeper
from runtime.drawing.report_page.timeline import Moment, Timeline
from runtime.engine_facts import EngineFacts
from runtime.health.frame_health import FrameHealth
from runtime.io.atomic_write import atomic_path
from runtime.prediction import Prediction
from runtime.run.pipeline import OK, FrameRecord, StreamResult
from runtime.sources.frames import Frame
from runtime.sync.latency import LatencyStatistics, MissedDeadlines, latency_statistics


class RunPage:
    """Looks at the frames of a run while they are written, and makes its page at the end."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._started = datetime.now(UTC)
        self._samples = SampleKeeper(contract)
        self._frame_health = FrameHealth()
        self._health: dict[str, tuple[str, ...]] = {}  # of frames where anything is wrong

    def write(self, name: str, frame: Frame, prediction: Prediction) -> None:
        """Look at a frame and its answer; nothing is written yet."""
        health = self._frame_health.check(frame.rgb, frame.sparse_depth)
        if health:
            self._health[name] = health
        self._samples.look(name, frame.rgb, prediction, health)

    def finish(
        self, path: Path, result: StreamResult, report: Mapping[str, Any], engine: EngineFacts
    ) -> None:
        """Write the page. Raises OutputError.

        report: of the same run, as `build_report` makes it
        """
        deadline = report["deadline"]
        deadline_ms = deadline["deadline_ms"] if deadline else None
        timeline = Timeline()
        for record in result.records:
            timeline.add(self._moment(record, deadline_ms))
        responses_ms = (record.response_ms for record in result.records)
        content = PageContent(
            title=f"Run of {self._contract.model_name}",
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            interrupted=result.interrupted,
            contract=self._contract,
            timeline=timeline,
            response="prediction" if result.rate_hz is None else "age",
            responses=latency_statistics(each for each in responses_ms if each is not None),
            stages={
                stage: LatencyStatistics(**figures) if figures else None
                for stage, figures in report["stages"].items()
            },
            deadline_ms=deadline_ms,
            missed=MissedDeadlines(deadline["count"], deadline["longest_run"])
            if deadline
            else None,
            frames=report["frames"]["by_status"],
            frames_per_second=report["frames_per_second"],
            problems=[Problem(**entry) for entry in report["frames"]["not_ok"]],
            samples=self._samples.samples(),
            facts=collect_facts(engine, "Run", _run_facts(report, self._started)),
        )
        with atomic_path(path) as made:
            made.write_bytes(render_page(content))

    def _moment(self, record: FrameRecord, deadline_ms: float | None) -> Moment:
        marks = [*record.degraded, *self._health.get(record.name, ())]
        if record.status != OK:
            marks.insert(0, record.status)
        response_ms = record.response_ms
        if deadline_ms is not None and response_ms is not None and response_ms > deadline_ms:
            marks.append(LATE)
        return Moment(
            record.name,
            response_ms=response_ms,
            marks=tuple(marks),
            returns=None if record.latency is None else record.depth_returns,
        )


def _run_facts(report: Mapping[str, Any], started: datetime) -> dict[str, Any]:
    scenario = report["scenario"]
    rate = f", {scenario['rate_hz']:g} Hz" if scenario["rate_hz"] else ""
    sizes = report["frames"]["by_network_size"].items()
    return {
        "started": f"{started:%Y-%m-%d %H:%M:%S} UTC",
        "took": f"{report['wall_s']:.1f} s",
        "scenario": scenario["name"] + rate,
        **{name.replace("_", " "): value for name, value in report["inputs"].items()},
        "network ran at": ", ".join(f"{size} ({count})" for size, count in sizes),
        "output": report["output"],
        "saved": ", ".join(report["saved"]) or "nothing",
    }
