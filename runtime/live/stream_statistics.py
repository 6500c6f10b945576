"""Statistics of a stream: latency, age, skew, jitter and missed deadlines."""

from dataclasses import asdict, dataclass
from typing import Any

from runtime.live.frame_result import FrameResult
from runtime.sync.histogram import DurationHistogram
from runtime.sync.latency import (
    Jitter,
    LatencyStatistics,
    MissCounter,
    MissedDeadlines,
    latency_table,
)

_FIGURES = (
    "preprocess",
    "inference",
    "postprocess",
    "predict",
    "latency",
    "age",
    "skew",
    "depth age",
    "jitter",
)


@dataclass(frozen=True)
class StreamStatistics:
    """Statistics of all results of a stream so far.

    Attributes:
        stages: figure -> statistics in milliseconds, None without a value. Of
            `Prediction.latency`: "preprocess", "inference", "postprocess" and "predict". Of
            `FrameResult`: "latency" and "age". "skew": absolute, of images with depth of their
            own. "depth age": of all images with depth, 0 where it is newer than its image.
            "jitter": |(t2 - t1) - (s2 - s1)| of two successive results at the times t with the
            image stamps s (the transit-time difference of RFC 3550).
        deadline_ms: as given to the stream.
        missed: late results; None without a deadline.
    """

    stages: dict[str, LatencyStatistics | None]
    deadline_ms: float | None
    missed: MissedDeadlines | None

    def to_dict(self) -> dict[str, Any]:
        """Return the entries "stages" and "deadline" of a report.json, ready for `json.dumps`."""
        return {
            "stages": {
                name: None if figures is None else asdict(figures)
                for name, figures in self.stages.items()
            },
            "deadline": None
            if self.missed is None
            else {"deadline_ms": self.deadline_ms, **asdict(self.missed)},
        }

    def table(self) -> str:
        """Return a text table with one line per statistic."""
        missed = [] if self.missed is None else [self.missed.line(self.deadline_ms)]
        return "\n".join([latency_table(self.stages), *missed])


class StatisticsRecorder:
    """Collects the figures of results in constant memory; the stream's lock guards it."""

    def __init__(self, deadline_ms: float | None) -> None:
        self._deadline_ms = deadline_ms
        self._histograms = {name: DurationHistogram() for name in _FIGURES}
        self._misses = MissCounter()
        self._jitter = Jitter()

    def record(self, result: FrameResult, *, transit_ns: int) -> None:
        """Add a result; transit: its time - the image's stamp, each by its own clock."""
        latency = result.prediction.latency
        figures_ms = {
            "preprocess": latency.preprocess_ms,
            "inference": latency.inference_ms,
            "postprocess": latency.postprocess_ms,
            "predict": latency.total_ms,
            "latency": result.latency_ms,
            "age": result.age_ms,
            "skew": (
                None if result.skew_ms is None or result.depth_reused else abs(result.skew_ms)
            ),
            "depth age": (None if result.depth_age_ms is None else max(result.depth_age_ms, 0.0)),
            "jitter": self._jitter.record(transit_ns),
        }
        for name, value_ms in figures_ms.items():
            if value_ms is not None:
                self._histograms[name].record(value_ms)
        if result.deadline_met is not None:
            self._misses.record(late=not result.deadline_met)

    def reset_jitter(self) -> None:
        """The stamps jumped: the next answer has no jitter."""
        self._jitter.reset()

    def statistics(self) -> StreamStatistics:
        """The statistics so far."""
        return StreamStatistics(
            stages={name: each.statistics() for name, each in self._histograms.items()},
            deadline_ms=self._deadline_ms,
            missed=None if self._deadline_ms is None else self._misses.misses(),
        )
