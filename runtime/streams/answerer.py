"""The prediction of a matched frame, and the checks of its sensors."""

import contextlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.errors import SSDNetError
from runtime.health.consistency import ConsistencyCheck
from runtime.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility
from runtime.health.frame_health import FrameHealth
from runtime.io.calibration import Calibration
from runtime.prediction import IMPLAUSIBLE_DEPTH, Prediction
from runtime.streams.frame_result import FrameResult
from runtime.sync.matching import Pair
from runtime.sync.motion import DepthInTime, Scan, keep_map, project_in_time
from runtime.sync.poses import PoseTrack

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
    """Projects, predicts and checks one frame of a stream after another. Not thread-safe."""

    def __init__(
        self,
        predictor: FramePredictor,
        calibration: Calibration | None,
        consistency: float | None,
        *,
        check_depth: bool = True,
    ) -> None:
        self._predictor, self._calibration = predictor, calibration
        self._health, self._plausibility = FrameHealth(), DepthPlausibility()
        self._is_implausible = False
        self._check_depth = check_depth
        self._last: tuple[Pair, NDArray[np.float32]] | None = None  # of the next check
        self._checks = self._since = 0  # checked frames; frames with depth since the last check
        self._answers = 0
        self._consistency = None if consistency is None else ConsistencyCheck(consistency)

    def answer(self, pair: Pair, poses: PoseTrack | None) -> FrameResult:
        """Answer a frame; raises what `Predictor.predict` raises.

        poses: of the LiDAR over the time of the frame; None = of a stream without poses.
        """
        image, depth, reused = pair
        rgb = image.data
        sparse_depth, motion, reasons, lost = self._sparse_depth(pair, poses)
        if self._consistency is None or pair.own_depth is None:
            prediction, consistency = self._predict(rgb, sparse_depth, pair), None
        else:
            left, held_out = self._consistency.hold_out(sparse_depth)
            prediction, camera_only = self._predict(rgb, left, pair), None
            if self._consistency.scale_is_due:
                camera_only = self._predict(rgb, np.zeros(rgb.shape[:2], np.float32), pair)
                if self._check_depth:
                    self._judge(camera_only, sparse_depth)
            consistency = self._consistency.score(
                prediction, camera_only, sparse_depth, held_out, stamp_ns=image.stamp_ns
            )
        if depth is not None:
            self._since += 1
            self._last = None if prediction.depth is None else (pair, sparse_depth)
            if self._is_implausible:
                reasons = (IMPLAUSIBLE_DEPTH, *reasons)
        prediction = prediction.after_reading(reasons, lost)
        # `predict` has checked that they fit.
        health = self._health.check(rgb, sparse_depth, range_m=prediction.range_m)
        self._answers += 1
        return FrameResult(
            sequence=self._answers - 1,
            rgb=np.broadcast_to(rgb, rgb.shape),  # read-only
            prediction=prediction,
            health=health,
            consistency=consistency,
            image_stamp=image.stamp,
            depth_stamp=None if depth is None else depth.stamp,
            depth_reused=reused,
            depth_motion=None if depth is None else motion,
            latency_ms=prediction.latency.total_ms,
            age_ms=prediction.latency.total_ms,
        )

    def _sparse_depth(self, pair: Pair, poses: PoseTrack | None) -> DepthInTime:
        """The depth map, how its returns were moved, and what is wrong with it."""
        depth, image = pair.depth, pair.image
        size = image.data.shape[:2]
        if depth is None:
            return DepthInTime(np.zeros(size, np.float32), "none", ())
        scan = depth.data
        if not isinstance(scan, Scan):
            apart = depth.stamp_ns != image.stamp_ns
            return keep_map(scan, apart=apart, has_poses=poses is not None, reused=pair.reused)
        assert self._calibration is not None  # push_points requires it
        return project_in_time(
            self._calibration, scan, poses, image.stamp_ns, size, reused=pair.reused
        )

    def check_last(self, *, idle: bool) -> None:
        """Compare the returns of the last frame with a prediction from its image alone, if due.

        The first FIRST_FRAMES with depth are, then one in _CHECK_EVERY, when the stream is idle.
        With `consistency` its predictions serve.
        """
        last, self._last = self._last, None
        if last is None or self._consistency is not None or not self._check_depth:
            return
        if self._checks >= FIRST_FRAMES and not (idle and self._since >= _CHECK_EVERY):
            return
        self._checks, self._since = self._checks + 1, 0
        pair, sparse_depth = last
        with contextlib.suppress(SSDNetError):  # the next frame's own prediction reports it
            camera_only = self._predict(pair.image.data, np.zeros_like(sparse_depth), pair)
            self._judge(camera_only, sparse_depth)

    def _judge(self, camera_only: Prediction, sparse_depth: NDArray[np.float32]) -> None:
        self._plausibility.add(camera_only, sparse_depth)
        self._is_implausible = self._plausibility.finding() is not None

    def _predict(
        self, rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32], pair: Pair
    ) -> Prediction:
        focal_px = None
        if self._calibration is not None and self._predictor.focal_length_px is None:
            focal_px = self._calibration.focal_length_px
        return self._predictor.predict(
            rgb, sparse_depth, focal_length_px=focal_px, stamp=pair.image.stamp
        )
