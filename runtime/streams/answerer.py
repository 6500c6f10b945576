"""The answer to a frame: one way for live streams, replays and runs."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from runtime.engine.prediction import Prediction
from runtime.geometry.calibration import Calibration
from runtime.streams.frame import Frame
from runtime.streams.frame_memory import FrameMemory
from runtime.streams.frame_result import FrameResult
from runtime.streams.stream_checks import StreamChecks


class FramePredictor(Protocol):
    """The part of a `Predictor` that a stream uses."""

    focal_length_px: float | None

    def predict(
        self,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        *,
        focal_length_px: float | None = None,
        stamp: Any = None,
    ) -> Prediction: ...


class Answerer:
    """Predicts and checks one frame of a stream after another. Not thread-safe.

    Args:
        predictor: a `Predictor`, or a drop-in replacement.
        checks: the checks of this stream.
        memory: adds earlier returns to each frame; None: each frame is answered alone.

    Raises:
        InputError: if `predictor` has no `predict`.
    """

    def __init__(
        self, predictor: FramePredictor, checks: StreamChecks, *, memory: FrameMemory | None = None
    ) -> None:
        if not callable(getattr(predictor, "predict", None)):
            raise InputError(f"predictor must be a Predictor, got {shown(predictor)}")
        self._predictor, self._checks, self._memory = predictor, checks, memory
        self._answers = 0

    def begin(self, frames: Iterable[Frame]) -> None:
        """Check the first frames of a recording before any of them is answered."""
        self._checks.begin(frames, self._predict)

    def answer(self, frame: Frame) -> tuple[Frame, FrameResult]:
        """Return a frame as it was predicted, and its answer.

        Raises what `Predictor.predict` raises.
        """
        if self._memory is not None:
            frame = self._memory.recall(frame)
        image, depth = frame.image, frame.depth
        prediction, consistency = self._checks.predict(frame, self._predict)
        if (further := frame.remembered) is not None:
            own = max(0, prediction.depth_returns - further.returned)
            prediction = replace(prediction, depth_returns=own)
        predictor_reasons = prediction.degraded
        if self._memory is not None:
            self._memory.answered(frame, prediction)
        reasons, health = self._checks.answered(frame, prediction)
        prediction = prediction.after_reading(reasons, frame.compensated.lost_points)
        self._answers += 1
        return frame, FrameResult(
            sequence=self._answers - 1,
            name=frame.name,
            rgb=np.broadcast_to(frame.rgb, frame.rgb.shape),  # read-only
            prediction=prediction,
            predictor_reasons=predictor_reasons,
            health=health,
            findings=self._checks.findings,
            consistency=consistency,
            image_stamp=image.stamp,
            depth_stamp=None if depth is None else depth.stamp,
            depth_reused=frame.reused,
            depth_motion=frame.depth_motion,
            memory_returns=0 if further is None else further.returned,
            memory_rejected=None if further is None else further.rejected_share,
            memory_off="" if further is None else further.off,
            latency_ms=prediction.latency.total_ms,
            age_ms=prediction.latency.total_ms,
        )

    def check_last(self, *, idle: bool) -> None:
        """Check what takes long, see `StreamChecks.judge`; to be called after each result."""
        self._checks.judge(self._predict, idle=idle)

    def _predict(self, frame: Frame, sparse_depth: NDArray[np.float32]) -> Prediction:
        focal_px = known_focal_length_px(self._predictor, frame.calibration)
        return self._predictor.predict(
            frame.rgb, frame.fed(sparse_depth), focal_length_px=focal_px, stamp=frame.image.stamp
        )


def known_focal_length_px(
    predictor: FramePredictor, calibration: Calibration | None
) -> float | None:
    """Return the focal length of the predictor, or else that of the calibration, if any."""
    if predictor.focal_length_px is not None or calibration is None:
        return predictor.focal_length_px
    return calibration.focal_length_px
