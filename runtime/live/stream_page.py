"""The page of a stream."""

import threading
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path

from runtime.drawing.report_page.charts import INVALID, LATE
from runtime.drawing.report_page.page import PageContent, render_page
from runtime.drawing.report_page.samples import SampleKeeper
from runtime.drawing.report_page.timeline import Moment, Timeline
from runtime.io.atomic_write import atomic_path
from runtime.io.engine_facts import engine_facts
from runtime.live.frame_result import FrameResult
from runtime.live.message_counter import MessageCounts
from runtime.live.push_stream import PushStream
from runtime.predictor import Predictor


class StreamPage:
    """Collects the results of a stream in bounded memory and writes its page.

    ```python
    page = StreamPage(predictor)
    with PushStream(predictor, mode="live", deadline_ms=50) as stream:
        for result in stream:
            page.add(result)
    page.write("report.html", stream)
    ```

    `add` draws a picture now and then. Both methods may be called from any thread, and `write`
    repeatedly, also while the stream runs.

    Args:
        predictor: of the stream.
    """

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
        self._started = datetime.now(UTC)
        self._lock = threading.Lock()
        self._timeline = Timeline()
        self._samples = SampleKeeper(predictor.contract)

    def add(self, result: FrameResult) -> None:
        """Add the next result."""
        prediction = result.prediction
        marks = [*prediction.degraded, *result.health]
        if not prediction.valid:
            marks.append(INVALID)
        if result.deadline_met is False:
            marks.append(LATE)
        name, returns = f"answer {result.sequence}", prediction.depth_returns
        with self._lock:
            self._timeline.add(Moment(name, result.latency_ms, tuple(marks), returns))
            self._samples.add(name, result.rgb, prediction, result.health)

    def write(self, path: str | PathLike[str], stream: PushStream) -> None:
        """Write the page of the results so far; an existing file is replaced.

        Args:
            path: of the HTML file.
            stream: of the results, open or closed; the page shows its statistics and counts.

        Raises:
            OutputError: if the file cannot be written.
        """
        statistics, counts, state = stream.statistics, stream.counts, stream.state
        facts = {
            "started": f"{self._started:%Y-%m-%d %H:%M:%S} UTC",
            "written": f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC",
            "state": ", ".join([state.level, *state.reasons]),
            "images": _outcomes(counts.images),
            "depth maps": _outcomes(counts.depths),
            "poses": _outcomes(counts.poses) if counts.poses.pushed else "none",
            "answered with an older scan": counts.reused,
            "answered from the camera alone": counts.camera_only,
            "out of order": counts.out_of_order,
            "stamps that jumped back": counts.jumps_back,
        }
        with self._lock:
            content = PageContent(
                kind="Stream",
                contract=self._predictor.contract,
                engine=engine_facts(self._predictor),
                timeline=self._timeline,
                response="latency",
                responses=statistics.stages["latency"],
                stages=statistics.stages,
                deadline_ms=statistics.deadline_ms,
                missed=statistics.missed,
                samples=self._samples.samples(),
                facts=facts,
            )
            page = render_page(content)
        with atomic_path(Path(path)) as made:
            made.write_bytes(page)


def _outcomes(counts: MessageCounts) -> str:
    """The outcomes of a sensor's messages, in words."""
    parts = [f"{counts.pushed:,} pushed", f"{counts.answered:,} answered"]
    for kind in ("dropped", "unmatched", "errors"):
        reasons = getattr(counts, kind)
        if reasons:
            words = ", ".join(f"{reason} {count:,}" for reason, count in reasons.items())
            parts.append(f"{sum(reasons.values()):,} {kind} ({words})")
    if counts.pending:
        parts.append(f"{counts.pending:,} pending")
    return "; ".join(parts)
