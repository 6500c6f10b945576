"""The answer to a frame, which runs, replays and live streams share, and its figures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.stamp import NS_PER_MS, Stamp, stamp_ns
from runtime.engine.prediction import Prediction
from runtime.geometry.motion import DepthMotion
from runtime.streams.health.consistency import Consistency

OK, SKIPPED, INVALID = "ok", "skipped", "invalid"
_NONE: Any = None  # only in the report of a run; a stream sets these fields in each result


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameResult:
    """The answer to an image and the depth of its time; fields that do not apply are None.

    Attributes:
        sequence: number of the answer in its stream, or of the frame in a run, from 0.
        name: name of the frame in a run.
        reason: why the status is not "ok".
        rgb: uint8 (H, W, 3), the image, read-only: the next check predicts from it. None in the
            report of a run.
        prediction: the answer of the `Predictor`. In the report of a run it has no arrays (`heads`
            is empty), and it is None if the frame could not be read or predicted.
        health: faults of the sensors, see `FrameHealth.check`; () if there are none.
        consistency: running figures of calibration and sync; None without the option `consistency`,
            or if the prediction is from the camera alone.
        image_stamp: stamp of the image as it was given to a stream; in a run, nanoseconds, or None
            if it is not known.
        depth_stamp: stamp of the depth in the same form; None if the prediction is from the camera
            alone (`prediction.degraded` then holds "no_depth").
        depth_reused: whether the depth is an older scan's (`prediction.degraded` then holds
            "depth_reused"), because the image has none of its own.
        depth_motion: "each" where each return was moved to the time of the image by its own time,
            "scan" where the scan was moved as one, "none" where it was not moved; None without
            depth.
        read_ms: time of reading and decoding, in a run.
        write_ms: time of writing to all outputs, in a run.
        latency_ms: the time that a deadline limits. In a live stream it starts when the image is
            pushed, and includes waiting for the depth and for the predictor. In a constant stream
            it starts when the frame is due. Otherwise it is the time of the prediction.
        age_ms: time of the answer by the stream's `sensor_clock` - stamp of the image; without such
            a clock, `latency_ms`. None in a run that is no constant stream.
        jitter_ms: |(t2 - t1) - (s2 - s1)| of this answer and the one before at the times t with the
            image stamps s, in a constant stream with the times s at which they were due (the
            transit-time difference of RFC 3550).
        deadline_met: whether latency_ms is within the deadline; None without one.
    """

    sequence: int
    name: str = ""
    reason: str = ""
    rgb: NDArray[np.uint8] = _NONE
    prediction: Prediction = _NONE
    health: tuple[str, ...] = ()
    consistency: Consistency | None = None
    image_stamp: Stamp = _NONE
    depth_stamp: Stamp | None = None
    depth_reused: bool = False
    depth_motion: DepthMotion | None = None
    read_ms: float | None = None
    write_ms: float | None = None
    latency_ms: float = _NONE
    age_ms: float = _NONE
    jitter_ms: float | None = None
    deadline_met: bool | None = None

    @property
    def status(self) -> str:
        """Return "ok", "skipped" without a prediction, or "invalid" with one that is not valid."""
        if self.prediction is None:
            return SKIPPED
        return OK if self.prediction.valid else INVALID

    @property
    def skew_ms(self) -> float | None:
        """Depth stamp - image stamp; None if one of them is not known."""
        if self.image_stamp is None or self.depth_stamp is None:
            return None
        return (stamp_ns(self.depth_stamp) - stamp_ns(self.image_stamp)) / NS_PER_MS

    @property
    def depth_age_ms(self) -> float | None:
        """Image stamp - depth stamp; None if one of them is not known."""
        return None if self.skew_ms is None else 0.0 - self.skew_ms  # no -0.0

    def in_report(self, sequence: int) -> "FrameResult":
        """The result for the report of a run: the frame's number, and neither arrays nor an age."""
        prediction = replace(self.prediction, heads={})
        return replace(self, sequence=sequence, rgb=_NONE, prediction=prediction, age_ms=_NONE)


# Figure [ms] -> the function that returns its value for a frame. "predict" is the whole time of
# `Predictor.predict`. "skew" is absolute, and only for images with depth of their own. "depth_age"
# is 0 if the depth is newer than the image.
FIGURES: dict[str, Callable[[FrameResult], float | None]] = {
    "read": lambda done: done.read_ms,
    "preprocess": lambda done: done.prediction.latency.preprocess_ms if done.prediction else None,
    "inference": lambda done: done.prediction.latency.inference_ms if done.prediction else None,
    "postprocess": lambda done: done.prediction.latency.postprocess_ms if done.prediction else None,
    "predict": lambda done: done.prediction.latency.total_ms if done.prediction else None,
    "write": lambda done: done.write_ms,
    "latency": lambda done: done.latency_ms,
    "age": lambda done: done.age_ms,
    "jitter": lambda done: done.jitter_ms,
    "skew": lambda done: None if done.skew_ms is None or done.depth_reused else abs(done.skew_ms),
    "depth_age": lambda done: None if (age := done.depth_age_ms) is None else max(age, 0.0),
}
