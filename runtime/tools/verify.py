"""Predict the frames of a recording again, and compare the answers with the recorded ones."""

import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from runtime.errors import InferenceError, InputError
from runtime.io.agreement import compare, first_figure, within, worst
from runtime.io.recording import RecordedFrame, Recording
from runtime.prediction import Prediction
from runtime.predictor import Predictor

VERIFY_FORMAT, VERIFY_VERSION = "ssdnet-verify", "2.0"

# The network may run at so many times the frame's pixels, and at so many pixels in any case.
_MAX_MAGNIFICATION = 16
_ANY_SIZE_PIXELS = 4_000_000


@dataclass(frozen=True)
class FrameCheck:
    """The comparison of one frame.

    Attributes:
        frame: as it was recorded.
        figures: head -> how far its answer is from the recorded one, see
            `runtime.io.agreement.compare`.
        failed: heads that differ by more than their limits.
        faults: other differences, in words; the figures of such a head are missing.
        predict_ms: time of the prediction now; None = there was none.
    """

    frame: RecordedFrame
    figures: Mapping[str, Mapping[str, float]]
    failed: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    predict_ms: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the answer is the recorded one."""
        return not self.failed and not self.faults


@dataclass(frozen=True)
class VerifyReport:
    """The comparison of a whole recording.

    Attributes:
        recording: that was compared.
        model: name of the model that answered now.
        sha256: digest of its file.
        provider: that it ran on.
        limits: head -> limits of its figures.
        checks: of the frames, in order.
        max_slowdown: limit of `slowdown`; None = times are not compared.
    """

    recording: Recording
    model: str
    sha256: str
    provider: str
    limits: Mapping[str, Mapping[str, float]]
    checks: tuple[FrameCheck, ...]
    max_slowdown: float | None = None

    @property
    def same_model(self) -> bool:
        """Whether the model is the recorded one."""
        return self.sha256 == self.recording.model_sha256

    @property
    def failed(self) -> list[FrameCheck]:
        """Frames whose answers differ."""
        return [check for check in self.checks if not check.passed]

    @cached_property
    def slowdown(self) -> float | None:
        """The median time now over the recorded one; None where no times were recorded."""
        pairs = [
            (check.predict_ms, check.frame.predict_ms)
            for check in self.checks
            if check.predict_ms is not None and check.frame.predict_ms is not None
        ]
        if not pairs:
            return None
        now_ms, recorded_ms = zip(*pairs, strict=True)
        return float(statistics.median(now_ms) / max(statistics.median(recorded_ms), 1e-9))

    @property
    def slow(self) -> bool:
        """Whether predictions take more than `max_slowdown` times what was recorded."""
        if self.slowdown is None or self.max_slowdown is None:
            return False
        return self.slowdown > self.max_slowdown

    @property
    def passed(self) -> bool:
        """Whether there are answers, and all are the recorded ones within `max_slowdown`."""
        return bool(self.checks) and not self.slow and not self.failed

    def worst(self, head: str) -> dict[str, float] | None:
        """The worst of each figure of a head over all frames; None if no frame has any."""
        figures = [check.figures[head] for check in self.checks if head in check.figures]
        return worst(figures) if figures else None

    def document(self) -> dict[str, Any]:
        """Return the content of --json, see VERIFY_VERSION."""
        return {
            "format": VERIFY_FORMAT,
            "version": VERIFY_VERSION,
            "passed": self.passed,
            "recording": str(self.recording.folder),
            "made_by": self.recording.settings.made_by,
            "recorded_on": self.recording.settings.provider,
            "provider": self.provider,
            "model": self.model,
            "sha256": self.sha256,
            "same_model": self.same_model,
            "limits": self.limits,
            "slowdown": self.slowdown,
            "max_slowdown": self.max_slowdown,
            "frames": [{**asdict(check), "passed": check.passed} for check in self.checks],
        }


def verify(
    predictor: Predictor,
    recording: Recording,
    *,
    tolerances: Mapping[str, float],
    max_slowdown: float | None = None,
) -> VerifyReport:
    """Predict each recorded frame, and compare the answers with the recorded ones.

    Each new size of frame is predicted once before it is timed.

    Args:
        predictor: answers the frames.
        recording: frames and answers.
        tolerances: head -> limit of its first figure (share of equal pixels, largest or mean
            difference), in place of the recording's limits.
        max_slowdown: limit of the median time over the recorded one; None = not compared.

    Raises:
        InputError: if the arrays of the recording are damaged, if it lacks a head of `tolerances`,
            or times for `max_slowdown`.
    """
    if unknown := sorted(tolerances.keys() - recording.limits.keys()):
        raise InputError(
            f"--tolerance names {', '.join(unknown)}, the recording holds "
            f"{', '.join(recording.limits)}"
        )
    given = {head: {first_figure(head): value} for head, value in tolerances.items()}
    limits = {**recording.limits, **given}
    warm: set[tuple[int, ...]] = set()
    checks = tuple(
        _check_frame(predictor, frame, recording.arrays(index), limits, warm)
        for index, frame in enumerate(recording.frames)
    )
    report = VerifyReport(
        recording,
        predictor.contract.model_name,
        predictor.digest,
        predictor.provider,
        limits,
        checks,
        max_slowdown,
    )
    if max_slowdown is not None and report.slowdown is None:
        raise InputError(
            "--max-slowdown needs times, and this recording has none: record with ssdnet-run"
        )
    return report


def _check_frame(
    predictor: Predictor,
    frame: RecordedFrame,
    arrays: dict[str, NDArray[Any]],
    limits: Mapping[str, Mapping[str, float]],
    warm: set[tuple[int, ...]],
) -> FrameCheck:
    """Predict a frame again. warm: shapes of pictures that were predicted before."""
    rgb, sparse_depth = arrays.pop("rgb"), arrays.pop("sparse_depth")
    _check_size(predictor, rgb.shape[:2])
    try:
        if rgb.shape not in warm:
            predictor.predict(rgb, sparse_depth)
            warm.add(rgb.shape)
        prediction = predictor.predict(rgb, sparse_depth)
    except InferenceError as error:
        return FrameCheck(frame, {}, faults=(str(error),))
    faults = _other_flags(prediction, frame)
    if prediction.heads.keys() != limits.keys():
        faults.append(f"the heads are {_named(prediction.heads)}, expected {_named(limits)}")
    figures: dict[str, dict[str, float]] = {}
    for head, expected in arrays.items():
        answer = prediction.heads.get(head)
        if answer is None:
            continue
        if answer.shape != expected.shape or expected.dtype.kind not in "uif":
            faults.append(
                f"{head} is {answer.dtype} {answer.shape}, expected {expected.dtype} "
                f"{expected.shape}"
            )
        else:
            figures[head] = compare(head, answer, expected)
    failed = tuple(
        head for head in limits if head in figures and not within(figures[head], limits[head])
    )
    return FrameCheck(frame, figures, failed, tuple(faults), prediction.latency.total_ms)


def _check_size(predictor: Predictor, frame_size: tuple[int, ...]) -> None:
    """Raise InputError for a network size far beyond the frame's, which takes gigabytes."""
    if len(frame_size) == 2 and min(frame_size) > 0:
        pixels = math.prod(predictor.network_size((frame_size[0], frame_size[1])))
        if pixels > max(_MAX_MAGNIFICATION * math.prod(frame_size), _ANY_SIZE_PIXELS):
            raise InputError(
                f"the recording has the network size {predictor.size} for a frame of "
                f"{frame_size[0]} x {frame_size[1]}: it was changed, record again"
            )


def _other_flags(prediction: Prediction, frame: RecordedFrame) -> list[str]:
    faults = []
    if prediction.valid != frame.valid:
        faults.append(f"valid is {prediction.valid}, expected {frame.valid}")
    if frame.degraded is not None and prediction.degraded != frame.degraded:
        faults.append(
            f"degraded is {_named(prediction.degraded)}, expected {_named(frame.degraded)}"
        )
    return faults


def _named(names: Iterable[str]) -> str:
    return ", ".join(names) or "nothing"
