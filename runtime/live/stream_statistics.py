"""Statistics of a stream: latency, age, skew, jitter and missed deadlines."""

from runtime.live.frame_result import FrameResult
from runtime.sync.frame_outcome import FIGURES
from runtime.sync.histogram import DurationHistogram
from runtime.sync.latency import MissCounter, StreamStatistics

_OF_A_RUN = ("read", "write")


class StatisticsRecorder:
    """Collects the figures of results in constant memory; the stream's lock guards it."""

    def __init__(self, deadline_ms: float | None) -> None:
        self._deadline_ms = deadline_ms
        self._histograms = {name: DurationHistogram() for name in FIGURES if name not in _OF_A_RUN}
        self._misses = MissCounter()

    def record(self, result: FrameResult) -> None:
        """Add a result."""
        for name, histogram in self._histograms.items():
            if (value_ms := FIGURES[name](result)) is not None:
                histogram.record(value_ms)
        if result.deadline_met is not None:
            self._misses.record(late=not result.deadline_met)

    def statistics(self) -> StreamStatistics:
        """The statistics so far."""
        return StreamStatistics(
            stages={name: each.statistics() for name, each in self._histograms.items()},
            deadline_ms=self._deadline_ms,
            missed=None if self._deadline_ms is None else self._misses.misses(),
        )
