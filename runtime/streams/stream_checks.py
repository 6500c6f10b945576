"""What is checked of the frames of a stream, live, replayed or in a run."""

import contextlib
from collections.abc import Iterable
from functools import partial

import numpy as np

from runtime.base.errors import SSDNetError
from runtime.checks.catalog import check_accepted
from runtime.checks.consistency import Consistency, ConsistencyCheck
from runtime.checks.finding import Finding
from runtime.checks.frame_health import FrameHealth
from runtime.checks.judge import FIRST_FRAMES, Judge, Judgement
from runtime.checks.poses import PosedScan, PoseJudge
from runtime.engine.prediction import Prediction
from runtime.geometry.poses import PoseTrack
from runtime.streams.frame import Frame
from runtime.streams.frame_view import Predict, view_of
from runtime.streams.messages import Scan

_CHECK_EVERY = 100  # frames with depth, after the first FIRST_FRAMES


class StreamChecks:
    """Judges a stream, in the thread that predicts, at the same moments in every stream.

    The first `FIRST_FRAMES` frames with depth are judged by a prediction from the image alone, then
    one frame in `_CHECK_EVERY`, when the stream is idle. With `consistency`, the predictions of
    that check are used instead.

    Args:
        consistency: share of the returns that is held out, see `ConsistencyCheck`; None: no check.
        check_depth: whether returns are judged by predictions from the image alone.
        has_lidar: whether the car has a LiDAR, so that an image without depth is a fault; False =
            this is assumed from the first frame with depth on.
        accept: names of findings that are not reported.
        depth_scale: see `View`.
        focal_px: see `View`.

    Attributes:
        judgement: what the last frames that were judged show.

    Raises:
        InputError: if `consistency` is out of range, or a name is unknown.
    """

    def __init__(
        self,
        *,
        consistency: float | None = None,
        check_depth: bool = True,
        has_lidar: bool = False,
        accept: Iterable[str] = (),
        depth_scale: float | None = None,
        focal_px: float | None = None,
    ) -> None:
        self._health = FrameHealth(has_lidar=has_lidar)
        self._judge, self._poses, self._check_depth = Judge(), PoseJudge(), check_depth
        self._view_of = partial(view_of, depth_scale=depth_scale, focal_px=focal_px)
        self._accepted = check_accepted(accept)
        self._consistency = None if consistency is None else ConsistencyCheck(consistency)
        self.judgement = Judgement()
        self._pose_fault: Finding | None = None
        self._posed: tuple[PosedScan, PoseTrack] | None = None  # not compared yet
        self._last: Frame | None = None  # of the next check
        self._checks = self._since = 0  # checked frames; frames with depth since the last check

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found so far and is not accepted."""
        found = (*self.judgement.findings, self._pose_fault)
        return tuple(each for each in found if each and each.name not in self._accepted)

    def predict(self, frame: Frame, predict: Predict) -> tuple[Prediction, Consistency | None]:
        """Answer a frame; some returns may be held out to score the answer by them."""
        sparse_depth = frame.sparse_depth
        if self._consistency is None or frame.own_depth is None:
            return predict(frame, sparse_depth), None
        left, held_out = self._consistency.hold_out(sparse_depth)
        prediction, camera_only = predict(frame, left), None
        if self._consistency.scale_is_due:
            camera_only = predict(frame, np.zeros_like(sparse_depth))
            if self._check_depth:
                self._add(frame, camera_only, predict)
        return prediction, self._consistency.score(
            prediction, camera_only, sparse_depth, held_out, stamp_ns=frame.image.time_ns
        )

    def answered(
        self, frame: Frame, prediction: Prediction
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the stream's reasons for `Prediction.degraded`, and `FrameResult.health`."""
        own, reasons = frame.own_depth, frame.degraded
        if frame.depth is not None:
            self._since += 1
            self._last = frame if prediction.depth is not None and self._check_depth else None
            found = self.judgement.findings
            reasons = (*self._reasons(found), *reasons)
        if own is not None and frame.poses is not None:
            reasons += self._reasons((self._pose_fault,))
            if isinstance(own, Scan) and own.times is not None:
                self._posed = PosedScan(own.points, own.times, frame.image.time_ns), frame.poses
        scan = own.points if isinstance(own, Scan) else None if own is None else own.sparse_depth
        return reasons, self._health.check(
            frame.rgb,
            frame.sparse_depth,
            scan=scan,
            reused=frame.reused,
            range_m=prediction.range_m,
        )

    def begin(self, frames: Iterable[Frame], predict: Predict) -> None:
        """Judge the first frames of a recording before any of them is answered."""
        for frame in frames:
            self._last = frame if self._check_depth else None
            self.judge(predict, idle=True)

    def judge(self, predict: Predict, *, idle: bool) -> None:
        """Do what takes long, after the result was handed over; `idle`: no other frame waits."""
        posed, self._posed = self._posed, None
        if posed is not None and self._pose_fault is None and self._poses.add(*posed):
            self._pose_fault = self._poses.finding()
        last, self._last = self._last, None
        if last is None or self._consistency is not None:
            return
        if self._checks >= FIRST_FRAMES and not (idle and self._since >= _CHECK_EVERY):
            return
        self._checks, self._since = self._checks + 1, 0
        with contextlib.suppress(SSDNetError):  # the next frame's own prediction reports it
            self._add(last, predict(last, np.zeros_like(last.sparse_depth)), predict)

    def _reasons(self, found: Iterable[Finding | None]) -> tuple[str, ...]:
        reported = (each for each in found if each is not None and each in self.findings)
        return tuple(dict.fromkeys(each.reason for each in reported if each.reason))

    def _add(self, frame: Frame, camera_only: Prediction, predict: Predict) -> None:
        view = self._view_of(frame, camera_only, predict=predict)
        if view is not None:
            self._judge.add(view)
            self.judgement = self._judge.judgement()
