"""What the report of a run keeps of a frame, and all that can be wrong with it or a sensor."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from runtime.base.stamp import stamp_ns
from runtime.checks.frame_health import SENSOR_FAULTS
from runtime.contract.degraded import DEGRADED
from runtime.engine.prediction import Prediction
from runtime.streams.frame_result import FIGURES, FrameResult

OK, SKIPPED, INVALID = "ok", "skipped", "invalid"

# The stages of a run, in the order of its table. "latency" is none of them, because it equals "age"
# or "predict".
STAGES = (
    *("read", "preprocess", "inference", "postprocess", "predict", "write"),
    *("age", "jitter", "skew", "depth_age"),
)

LATE, CALIBRATION = "late", "calibration"
CAMERA_SILENT, LIDAR_SILENT = "camera_silent", "lidar_silent"
# The meaning of each reason. --fail-on takes these reasons.
REASONS = {
    SKIPPED: "could not be read or predicted",
    INVALID: "the answer cannot be used",
    LATE: "later than the deadline",
    CALIBRATION: "the returns fit the images better another way",
    **DEGRADED,
    **SENSOR_FAULTS,
    CAMERA_SILENT: "no image for some time",
    LIDAR_SILENT: "no scan or depth map for some time",
}
_OF_RUN = ("age", "jitter")  # figures of a constant stream, which are not those of the answer
_NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameRecord:
    """A frame of a run: its outcome and its figures, without arrays.

    Attributes:
        name: name of the frame in its recording.
        reason: why the status is not "ok".
        image_stamp_ns: stamp of the image; None if unknown.
        result: the answer without arrays (`prediction.heads` is empty); None if the frame could not
            be read or predicted.
        times_ms: figure -> value, for the figures that the frame has: those of `FIGURES`; "read",
            the time of reading and decoding; and "write", the time of writing to all outputs. "age"
            and "jitter" exist in a constant stream only, and start when a frame is due.
        deadline_met: whether "latency" is within the deadline; None without one.
    """

    name: str
    reason: str = ""
    image_stamp_ns: int | None = None
    result: FrameResult | None = None
    times_ms: Mapping[str, float] = field(default_factory=dict)
    deadline_met: bool | None = None

    @classmethod
    def of(
        cls, result: FrameResult, times_ms: Mapping[str, float], deadline_ms: float | None = None
    ) -> "FrameRecord":
        """Return the record of an answer.

        Args:
            result: the answer.
            times_ms: "read" and, if the frame was due at a time, "age" and "jitter".
            deadline_ms: limit of the latency, which is the age, or else that of the answer.
        """
        prediction, latency_ms = result.prediction, times_ms.get("age", result.latency_ms)
        figures = {name: figure(result) for name, figure in FIGURES.items() if name not in _OF_RUN}
        figures |= {**times_ms, "latency": latency_ms}
        return cls(
            name=result.name,
            reason="" if prediction.valid else ", ".join(result.predictor_reasons),
            image_stamp_ns=None if result.image_stamp is None else stamp_ns(result.image_stamp),
            result=replace(result, rgb=_NO_IMAGE, prediction=replace(prediction, heads={})),
            times_ms={name: time_ms for name, time_ms in figures.items() if time_ms is not None},
            deadline_met=None if deadline_ms is None else latency_ms <= deadline_ms,
        )

    def written(self, write_ms: float) -> "FrameRecord":
        """Return the record with the time of writing to all outputs."""
        return replace(self, times_ms={**self.times_ms, "write": write_ms})

    @property
    def prediction(self) -> Prediction | None:
        """The prediction without arrays; None if the frame could not be read or predicted."""
        return self.result.prediction if self.result else None

    @property
    def status(self) -> str:
        """Return "ok", "skipped" without a prediction, or "invalid" with one that is not valid."""
        if self.prediction is None:
            return SKIPPED
        return OK if self.prediction.valid else INVALID

    @property
    def degraded(self) -> tuple[str, ...]:
        """The reasons of `Prediction.degraded`; () without a prediction."""
        return self.prediction.degraded if self.prediction else ()

    @property
    def health(self) -> tuple[str, ...]:
        """The faults of the sensors; () without an answer."""
        return self.result.health if self.result else ()

    @property
    def depth_stamp_ns(self) -> int | None:
        """The stamp of the depth; None if unknown."""
        stamp = self.result.depth_stamp if self.result else None
        return None if stamp is None else stamp_ns(stamp)

    @property
    def depth_source(self) -> str:
        """Return "own" for depth of the image itself, "reused" for older, "" without depth."""
        if self.result is None or self.result.depth_motion is None:
            return ""
        return "reused" if self.result.depth_reused else "own"
