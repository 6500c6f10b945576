"""The outcome of a run: one typed object, from which every table and document is made."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from runtime.io.encode import METRES_PNG_MAX_M, METRES_PNG_SCALE
from runtime.io.engine_facts import EngineFacts
from runtime.run.pipeline import OK, SKIPPED, FrameRecord, StreamResult
from runtime.sync.latency import LatencyStatistics, MissCounter, MissedDeadlines, latency_statistics

REPORT_FORMAT, REPORT_VERSION = "ssdnet-run", "2.0"
FRAMES_SKIPPED, DEADLINE_MISSED = 3, 4  # exit codes

# "predict" is Predictor.predict from end to end; "age" and "jitter" are of constant streams, "skew"
# and "depth_age" of sources whose sensors both have stamps.
STAGES: dict[str, Callable[[FrameRecord], float | None]] = {
    "read": lambda record: record.read_ms,
    "preprocess": lambda record: record.latency.preprocess_ms if record.latency else None,
    "inference": lambda record: record.latency.inference_ms if record.latency else None,
    "postprocess": lambda record: record.latency.postprocess_ms if record.latency else None,
    "predict": lambda record: record.latency.total_ms if record.latency else None,
    "write": lambda record: record.write_ms,
    "age": lambda record: record.age_ms,
    "jitter": lambda record: record.jitter_ms,
    "skew": lambda record: record.skew_ms,
    "depth_age": lambda record: None if (age := record.depth_age_ms) is None else max(age, 0.0),
}
_CONSTANT_STREAM = ("age", "jitter")
_OF_STAMPS = ("skew", "depth_age")


@dataclass(frozen=True)
class RunReport:
    """The outcome of a run.

    Attributes:
        engine: facts of model, provider and machine.
        inputs: where the frames came from, as the user gave it; ready for JSON.
        out: folder of the results.
        saved: kinds of files that were written of each frame.
        stream: records of the frames.
        deadline_ms: of each frame's `response_ms`; None = there was none.
        implausible_depth: why the returns cannot be right; None = nothing was found.
    """

    engine: EngineFacts
    inputs: Mapping[str, Any]
    out: Path
    saved: tuple[str, ...]
    stream: StreamResult
    deadline_ms: float | None = None
    implausible_depth: str | None = None

    @classmethod
    def of_rig(
        cls, reports: Mapping[str, "RunReport"], out: Path, *, interrupted: bool
    ) -> "RunReport":
        """Return the reports of several cameras as one; its frames are named CAMERA/FRAME.

        Args:
            reports: camera -> its report; engine and settings are those of the first.
            out: folder of the results of all cameras.
            interrupted: whether cameras are missing.
        """
        first, *_ = reports.values()
        named = [
            replace(record, name=f"{camera}/{record.name}")
            for camera, report in reports.items()
            for record in report.records
        ]
        stream = replace(
            first.stream,
            records=tuple(replace(record, index=index) for index, record in enumerate(named)),
            wall_s=sum(report.stream.wall_s for report in reports.values()),
            interrupted=interrupted or any(each.stream.interrupted for each in reports.values()),
        )
        found = [
            f"{camera}: {report.implausible_depth}"
            for camera, report in reports.items()
            if report.implausible_depth is not None
        ]
        return replace(
            first,
            inputs={"cameras": {camera: report.inputs for camera, report in reports.items()}},
            out=out,
            stream=stream,
            implausible_depth="; ".join(found) or None,
        )

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """Records of the frames, in order."""
        return self.stream.records

    @property
    def scenario(self) -> str:
        """Which of MLPerf's scenarios it was."""
        return "single-stream" if self.stream.rate_hz is None else "constant-stream"

    @property
    def by_status(self) -> Counter[str]:
        """Status -> frames."""
        return Counter(record.status for record in self.records)

    @property
    def degraded(self) -> Counter[str]:
        """Reason of `Prediction.degraded` -> frames."""
        return Counter(reason for record in self.records for reason in record.degraded)

    @property
    def health(self) -> Counter[str]:
        """Finding of `runtime.health` -> frames."""
        return Counter(reason for record in self.records for reason in record.health)

    @property
    def depth_sources(self) -> Counter[str]:
        """Own or reused, and how the returns were moved -> frames with depth."""
        return Counter(
            f"{record.depth_source}, motion {record.depth_motion}"
            for record in self.records
            if record.depth_motion is not None
        )

    @property
    def by_network_size(self) -> Counter[str]:
        """Size at which the network ran -> frames."""
        sizes = (record.network_size for record in self.records)
        return Counter(size_text(size) for size in sizes if size is not None)

    @property
    def not_ok(self) -> list[FrameRecord]:
        """Frames without an answer that can be used."""
        return [record for record in self.records if record.status != OK]

    @cached_property
    def stages(self) -> dict[str, LatencyStatistics | None]:
        """Stage -> statistics over the frames that passed it; the stages of the scenario."""
        left_out: tuple[str, ...] = () if self.stream.rate_hz is not None else _CONSTANT_STREAM
        left_out += tuple(
            stage
            for stage in _OF_STAMPS
            if all(STAGES[stage](record) is None for record in self.records)
        )
        return {
            stage: latency_statistics(_known(map(time_of, self.records)))
            for stage, time_of in STAGES.items()
            if stage not in left_out
        }

    @property
    def responses(self) -> LatencyStatistics | None:
        """Statistics of what the deadline limits."""
        return latency_statistics(_known(record.response_ms for record in self.records))

    @cached_property
    def missed(self) -> MissedDeadlines | None:
        """Frames that were later than the deadline; None without a deadline."""
        if self.deadline_ms is None:
            return None
        counter = MissCounter()
        for record in self.records:
            if record.response_ms is not None:
                counter.record(late=self.is_late(record))
        return counter.misses()

    def is_late(self, record: FrameRecord) -> bool:
        """Whether a frame was later than the deadline."""
        deadline_ms, response_ms = self.deadline_ms, record.response_ms
        return deadline_ms is not None and response_ms is not None and response_ms > deadline_ms

    @property
    def frames_per_second(self) -> float | None:
        """Rate of predicted frames, reading and writing included; None = none was predicted."""
        predicted = sum(record.status != SKIPPED for record in self.records)
        return predicted / self.stream.wall_s if predicted else None

    @property
    def exit_code(self) -> int:
        """0, FRAMES_SKIPPED (also if the depth is implausible), or DEADLINE_MISSED before all."""
        if self.missed is not None and self.missed.count:
            return DEADLINE_MISSED
        doubtful = self.implausible_depth is not None and self.records
        return FRAMES_SKIPPED if self.stream.interrupted or self.not_ok or doubtful else 0

    def document(self) -> dict[str, Any]:
        """Return the content of report.json, see REPORT_VERSION."""
        missed = self.missed
        return {
            "format": REPORT_FORMAT,
            "version": REPORT_VERSION,
            **asdict(self.engine),
            "inputs": self.inputs,
            "output": str(self.out),
            "saved": self.saved,
            "depth_png": {"units_per_metre": METRES_PNG_SCALE, "max_m": METRES_PNG_MAX_M},
            "frames": {
                "total": len(self.records),
                "by_status": self.by_status,
                "degraded": self.degraded,
                "health": self.health,
                "depth": self.depth_sources,
                "implausible_depth": self.implausible_depth,
                "by_network_size": self.by_network_size,
                "not_ok": [
                    {"name": record.name, "status": record.status, "reason": record.reason}
                    for record in self.not_ok
                ],
            },
            "interrupted": self.stream.interrupted,
            "scenario": {"name": self.scenario, "rate_hz": self.stream.rate_hz},
            "stages": {
                stage: None if statistics is None else asdict(statistics)
                for stage, statistics in self.stages.items()
            },
            "wall_s": self.stream.wall_s,
            "frames_per_second": self.frames_per_second,
            "deadline": missed and {"deadline_ms": self.deadline_ms, **asdict(missed)},
        }


def size_text(size: tuple[int, int] | None) -> str:
    """A (height, width) in words; None = any."""
    return "any size" if size is None else f"{size[0]} x {size[1]}"


def _known(times_ms: Iterable[float | None]) -> Iterable[float]:
    return (time_ms for time_ms in times_ms if time_ms is not None)
