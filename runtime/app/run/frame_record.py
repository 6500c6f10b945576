"""What the report of a run keeps of a frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from runtime.base.stamp import stamp_ns
from runtime.engine.prediction import Prediction
from runtime.geometry.motion import DepthMotion
from runtime.streams.frame_result import FIGURES, FrameResult

OK, SKIPPED, INVALID = "ok", "skipped", "invalid"

# The stages of a run, in the order of its table. "latency" is none of them, because it equals "age"
# or "predict".
STAGES = (
    "read",
    "preprocess",
    "inference",
    "postprocess",
    "predict",
    "write",
    "age",
    "jitter",
    "skew",
    "depth_age",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameRecord:
    """A frame of a run: its outcome and its figures, without arrays.

    Attributes:
        name: name of the frame in its recording.
        reason: why the status is not "ok".
        prediction: the prediction without arrays (`heads` is empty); None if the frame could not be
            read or predicted.
        image_stamp_ns, depth_stamp_ns: stamps of the image and of its depth; None if unknown.
        health, depth_reused, depth_motion, memory_returns, memory_rejected, memory_off: see
            `FrameResult`.
        times_ms: figure -> value, for the figures that the frame has: those of `FIGURES`; "read",
            the time of reading and decoding; and "write", the time of writing to all outputs. "age"
            and "jitter" exist in a constant stream only, and start when a frame is due.
        deadline_met: whether "latency" is within the deadline; None without one.
    """

    name: str
    reason: str = ""
    prediction: Prediction | None = None
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    health: tuple[str, ...] = ()
    depth_reused: bool = False
    depth_motion: DepthMotion | None = None
    memory_returns: int = 0
    memory_rejected: float | None = None
    memory_off: str = ""
    times_ms: Mapping[str, float] = field(default_factory=dict)
    deadline_met: bool | None = None

    @classmethod
    def of(
        cls,
        result: FrameResult,
        *,
        read_ms: float,
        age_ms: float | None = None,
        jitter_ms: float | None = None,
        deadline_ms: float | None = None,
    ) -> "FrameRecord":
        """Return the record of an answer.

        Args:
            result: the answer.
            read_ms: time of reading and decoding the frame.
            age_ms: time from when the frame was due to its answer; None: it was not due at a time.
            jitter_ms: the difference from the age of the answer before; None: there is none.
            deadline_ms: limit of the latency, which is the age, or else that of the answer.
        """
        prediction, latency_ms = result.prediction, result.latency_ms if age_ms is None else age_ms
        times_ms = {name: figure(result) for name, figure in FIGURES.items()}
        times_ms |= {"read": read_ms, "latency": latency_ms, "age": age_ms, "jitter": jitter_ms}
        return cls(
            name=result.name,
            reason="" if prediction.valid else ", ".join(result.predictor_reasons),
            prediction=replace(prediction, heads={}),
            image_stamp_ns=None if result.image_stamp is None else stamp_ns(result.image_stamp),
            depth_stamp_ns=None if result.depth_stamp is None else stamp_ns(result.depth_stamp),
            health=result.health,
            depth_reused=result.depth_reused,
            depth_motion=result.depth_motion,
            memory_returns=result.memory_returns,
            memory_rejected=result.memory_rejected,
            memory_off=result.memory_off,
            times_ms={name: time_ms for name, time_ms in times_ms.items() if time_ms is not None},
            deadline_met=None if deadline_ms is None else latency_ms <= deadline_ms,
        )

    def written(self, write_ms: float) -> "FrameRecord":
        """Return the record with the time of writing to all outputs."""
        return replace(self, times_ms={**self.times_ms, "write": write_ms})

    @property
    def status(self) -> str:
        """Return "ok", "skipped" without a prediction, or "invalid" with one that is not valid."""
        if self.prediction is None:
            return SKIPPED
        return OK if self.prediction.valid else INVALID

    @property
    def degraded(self) -> tuple[str, ...]:
        """The reasons of `Prediction.degraded`; () without a prediction."""
        return () if self.prediction is None else self.prediction.degraded
