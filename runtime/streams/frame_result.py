"""The answer to a frame, which runs, replays and live streams share, and its figures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.base.stamp import NS_PER_MS, Stamp, stamp_ns
from runtime.checks.consistency import Consistency
from runtime.checks.finding import Finding
from runtime.engine.prediction import Prediction
from runtime.geometry.motion import DepthMotion


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameResult:
    """The answer to an image and the depth of its time.

    Attributes:
        sequence: number of the answer in its stream or run, from 0.
        name: name of the frame in its recording; "" if it has none.
        rgb: uint8 (H, W, 3), the image, read-only: the next check predicts from it.
        prediction: the answer of the `Predictor`, whose `degraded` also holds the stream's reasons.
        predictor_reasons: `prediction.degraded` without the stream's reasons.
        health: faults of the sensors, see `FrameHealth.check`; () if there are none.
        findings: what the frames before show about calibration, depth and poses.
        consistency: running figures of calibration and sync; None without the option `consistency`,
            or if the prediction is from the camera alone.
        image_stamp: stamp of the image as it was given; None if its recording has no stamps.
        depth_stamp: stamp of the depth in the same form; also None if the prediction is from the
            camera alone (`prediction.degraded` then holds "no_depth").
        depth_reused: whether the depth is an older scan's (`prediction.degraded` then holds
            "depth_reused"), because the image has none of its own.
        depth_motion: "each" where each return was moved to the time of the image by its own time,
            "scan" where the scan was moved as one, "none" where it was not moved; None without
            depth.
        memory_returns: number of earlier returns that were fed beside those of the frame, which
            `prediction.depth_returns` counts.
        memory_rejected: share of the earlier returns that those of the frame contradict; None if
            there are none.
        memory_off: why no earlier return is fed although there are some; "" if nothing is wrong.
        latency_ms: the time that a deadline limits. In a live stream it starts when the image is
            pushed, and includes waiting for the depth and for the predictor. Otherwise it is the
            time of the prediction.
        age_ms: time of the answer by the stream's `sensor_clock` - stamp of the image; without such
            a clock, `latency_ms`.
        jitter_ms: |(t2 - t1) - (s2 - s1)| of this answer and the one before at the times t with the
            image stamps s, in a live stream (the transit-time difference of RFC 3550).
        deadline_met: whether latency_ms is within the deadline; None without one.
    """

    sequence: int
    name: str = ""
    rgb: NDArray[np.uint8]
    prediction: Prediction
    predictor_reasons: tuple[str, ...]
    health: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    consistency: Consistency | None = None
    image_stamp: Stamp | None
    depth_stamp: Stamp | None = None
    depth_reused: bool = False
    depth_motion: DepthMotion | None = None
    memory_returns: int = 0
    memory_rejected: float | None = None
    memory_off: str = ""
    latency_ms: float
    age_ms: float
    jitter_ms: float | None = None
    deadline_met: bool | None = None

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


# Figure [ms] -> the function that returns its value for an answer. "predict" is the whole time of
# `Predictor.predict`. "skew" is absolute, and only for images with depth of their own. "depth_age"
# is 0 if the depth is newer than the image.
FIGURES: dict[str, Callable[[FrameResult], float | None]] = {
    "preprocess": lambda answer: answer.prediction.latency.preprocess_ms,
    "inference": lambda answer: answer.prediction.latency.inference_ms,
    "postprocess": lambda answer: answer.prediction.latency.postprocess_ms,
    "predict": lambda answer: answer.prediction.latency.total_ms,
    "latency": lambda answer: answer.latency_ms,
    "age": lambda answer: answer.age_ms,
    "jitter": lambda answer: answer.jitter_ms,
    "skew": lambda answer: (
        None if answer.skew_ms is None or answer.depth_reused else abs(answer.skew_ms)
    ),
    "depth_age": lambda answer: None if (age := answer.depth_age_ms) is None else max(age, 0.0),
}
