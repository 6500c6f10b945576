"""The answer to a frame: its prediction, and the checks of its sensors."""

import contextlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.errors import InputError, SSDNetError
from runtime.checks.consistency import ConsistencyCheck
from runtime.checks.frame_health import FrameHealth
from runtime.contract.degraded import IMPLAUSIBLE_DEPTH, IMPLAUSIBLE_POSES
from runtime.engine.prediction import Prediction
from runtime.geometry.calibration import Calibration
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult
from runtime.streams.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility
from runtime.streams.health.pose_plausibility import PosePlausibility
from runtime.streams.messages import Scan

_CHECK_EVERY = 100  # frames with depth, after the first FIRST_FRAMES


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
        consistency: share of the returns that is held out, see `ConsistencyCheck`; None: no check.
        check_depth: whether `check_last` compares returns with a prediction from the image alone.
        has_lidar: whether the car has a LiDAR, so that an image without depth is a fault; False =
            this is assumed from the first frame with depth on.
        is_implausible: whether returns are known to be implausible until `check_last` clears them.

    Raises:
        InputError: if `consistency` is out of range, or `predictor` has no `predict`.
    """

    def __init__(
        self,
        predictor: FramePredictor,
        *,
        consistency: float | None = None,
        check_depth: bool = True,
        has_lidar: bool = False,
        is_implausible: bool = False,
    ) -> None:
        if not callable(getattr(predictor, "predict", None)):
            raise InputError(f"predictor must be a Predictor, got {shown(predictor)}")
        self._predictor = predictor
        self._health, self._plausibility = FrameHealth(has_lidar=has_lidar), DepthPlausibility()
        self._is_implausible = is_implausible
        self._poses = PosePlausibility()
        self._posed: Frame | None = None  # not compared with its poses yet
        # Why the poses cannot be right; None = nothing was found.
        self.pose_fault: str | None = None
        self._check_depth = check_depth
        self._last: Frame | None = None  # of the next check
        self._checks = self._since = 0  # checked frames; frames with depth since the last check
        self._answers = 0
        self._consistency = None if consistency is None else ConsistencyCheck(consistency)

    def answer(self, frame: Frame) -> FrameResult:
        """Answer a frame; raises what `Predictor.predict` raises."""
        rgb, image, depth = frame.rgb, frame.image, frame.depth
        sparse_depth, reasons = frame.sparse_depth, frame.degraded
        consistency = None
        if self._consistency is None or frame.own_depth is None:
            prediction = self._predict(frame, sparse_depth)
        else:
            left, held_out = self._consistency.hold_out(sparse_depth)
            prediction, camera_only = self._predict(frame, left), None
            if self._consistency.scale_is_due:
                camera_only = self._predict(frame, np.zeros_like(sparse_depth))
                if self._check_depth:
                    self._judge(camera_only, sparse_depth)
            consistency = self._consistency.score(
                prediction, camera_only, sparse_depth, held_out, stamp_ns=image.time_ns
            )
        predictor_reasons = prediction.degraded
        if depth is not None:
            self._since += 1
            self._last = None if prediction.depth is None or not self._check_depth else frame
            if self._is_implausible:
                reasons = (IMPLAUSIBLE_DEPTH, *reasons)
        if frame.own_depth is not None and frame.poses is not None:
            self._posed = frame
            reasons += () if self.pose_fault is None else (IMPLAUSIBLE_POSES,)
        prediction = prediction.after_reading(reasons, frame.compensated.lost_points)
        # `predict` has checked that they fit.
        own = frame.own_depth
        scan = own.points if isinstance(own, Scan) else None if own is None else own.sparse_depth
        health = self._health.check(
            rgb,
            sparse_depth,
            scan=scan,
            reused=frame.reused,
            range_m=prediction.range_m,
        )
        self._answers += 1
        return FrameResult(
            sequence=self._answers - 1,
            name=frame.name,
            rgb=np.broadcast_to(rgb, rgb.shape),  # read-only
            prediction=prediction,
            predictor_reasons=predictor_reasons,
            health=health,
            consistency=consistency,
            image_stamp=image.stamp,
            depth_stamp=None if depth is None else depth.stamp,
            depth_reused=frame.reused,
            depth_motion=frame.depth_motion,
            latency_ms=prediction.latency.total_ms,
            age_ms=prediction.latency.total_ms,
        )

    def check_last(self, *, idle: bool) -> None:
        """Compare the last frame with its poses, and its returns with its image alone, if due.

        The returns of the first `FIRST_FRAMES` frames with depth are compared, then those of one
        frame in `_CHECK_EVERY`, when the stream is idle. With `consistency`, the returns are
        compared with the predictions of that check instead.
        """
        posed, self._posed = self._posed, None
        if posed is not None and self.pose_fault is None and self._poses.add(posed):
            self.pose_fault = self._poses.finding()
        last, self._last = self._last, None
        if last is None or self._consistency is not None:
            return
        if self._checks >= FIRST_FRAMES and not (idle and self._since >= _CHECK_EVERY):
            return
        self._checks, self._since = self._checks + 1, 0
        with contextlib.suppress(SSDNetError):  # the next frame's own prediction reports it
            camera_only = self._predict(last, np.zeros_like(last.sparse_depth))
            self._judge(camera_only, last.sparse_depth)

    def _judge(self, camera_only: Prediction, sparse_depth: NDArray[np.float32]) -> None:
        self._plausibility.add(camera_only, sparse_depth)
        self._is_implausible = self._plausibility.finding() is not None

    def _predict(self, frame: Frame, sparse_depth: NDArray[np.float32]) -> Prediction:
        return self._predictor.predict(
            frame.rgb,
            sparse_depth,
            focal_length_px=known_focal_length_px(self._predictor, frame.calibration),
            stamp=frame.image.stamp,
        )


def known_focal_length_px(
    predictor: FramePredictor, calibration: Calibration | None
) -> float | None:
    """Return the focal length of the predictor, or else that of the calibration, if any."""
    if predictor.focal_length_px is not None or calibration is None:
        return predictor.focal_length_px
    return calibration.focal_length_px
