"""What is checked of the frames of a stream, live, replayed or in a run."""

import contextlib

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import SSDNetError
from runtime.checks.consistency import Consistency, ConsistencyCheck
from runtime.checks.frame_health import FrameHealth
from runtime.contract.degraded import IMPLAUSIBLE_DEPTH, IMPLAUSIBLE_POSES
from runtime.engine.prediction import Prediction
from runtime.streams.answerer import Predict
from runtime.streams.frame import Frame
from runtime.streams.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility
from runtime.streams.health.pose_plausibility import PosePlausibility
from runtime.streams.messages import Scan

_CHECK_EVERY = 100  # frames with depth, after the first FIRST_FRAMES


class StreamChecks:
    """The checks of one stream, see `Checks`.

    The returns of the first `FIRST_FRAMES` frames with depth are compared with a prediction from
    the image alone, then those of one frame in `_CHECK_EVERY`, when the stream is idle. With
    `consistency`, they are compared with the predictions of that check instead.

    Args:
        consistency: share of the returns that is held out, see `ConsistencyCheck`; None: no check.
        check_depth: whether returns are compared with a prediction from the image alone.
        has_lidar: whether the car has a LiDAR, so that an image without depth is a fault; False =
            this is assumed from the first frame with depth on.
        is_implausible: whether returns are known to be implausible until `judge` clears them.

    Attributes:
        pose_fault: why the poses cannot be right; None: nothing was found.

    Raises:
        InputError: if `consistency` is out of range.
    """

    def __init__(
        self,
        *,
        consistency: float | None = None,
        check_depth: bool = True,
        has_lidar: bool = False,
        is_implausible: bool = False,
    ) -> None:
        self._health, self._plausibility = FrameHealth(has_lidar=has_lidar), DepthPlausibility()
        self._poses, self._check_depth = PosePlausibility(), check_depth
        self._is_implausible = is_implausible
        self._consistency = None if consistency is None else ConsistencyCheck(consistency)
        self.pose_fault: str | None = None
        self._posed: Frame | None = None  # not compared with its poses yet
        self._last: Frame | None = None  # of the next check
        self._checks = self._since = 0  # checked frames; frames with depth since the last check

    def predict(self, frame: Frame, predict: Predict) -> tuple[Prediction, Consistency | None]:
        """See `Checks.predict`."""
        sparse_depth = frame.sparse_depth
        if self._consistency is None or frame.own_depth is None:
            return predict(frame, sparse_depth), None
        left, held_out = self._consistency.hold_out(sparse_depth)
        prediction, camera_only = predict(frame, left), None
        if self._consistency.scale_is_due:
            camera_only = predict(frame, np.zeros_like(sparse_depth))
            if self._check_depth:
                self._judge(camera_only, sparse_depth)
        return prediction, self._consistency.score(
            prediction, camera_only, sparse_depth, held_out, stamp_ns=frame.image.time_ns
        )

    def answered(
        self, frame: Frame, prediction: Prediction
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """See `Checks.answered`."""
        reasons, own = frame.degraded, frame.own_depth
        if frame.depth is not None:
            self._since += 1
            self._last = None if prediction.depth is None or not self._check_depth else frame
            reasons = (IMPLAUSIBLE_DEPTH, *reasons) if self._is_implausible else reasons
        if own is not None and frame.poses is not None:
            self._posed = frame
            reasons += () if self.pose_fault is None else (IMPLAUSIBLE_POSES,)
        scan = own.points if isinstance(own, Scan) else None if own is None else own.sparse_depth
        return reasons, self._health.check(
            frame.rgb,
            frame.sparse_depth,
            scan=scan,
            reused=frame.reused,
            range_m=prediction.range_m,
        )

    def judge(self, predict: Predict, *, idle: bool) -> None:
        """See `Checks.judge`."""
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
            self._judge(predict(last, np.zeros_like(last.sparse_depth)), last.sparse_depth)

    def _judge(self, camera_only: Prediction, sparse_depth: NDArray[np.float32]) -> None:
        self._plausibility.add(camera_only, sparse_depth)
        self._is_implausible = self._plausibility.finding() is not None
