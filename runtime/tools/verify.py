"""Give a recording's frames to a predictor, and hold its answers against the recorded ones."""

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from runtime.errors import InferenceError
from runtime.io.agreement import compare, within, worst
from runtime.io.recording import RecordedFrame, Recording
from runtime.predictor import Predictor


@dataclass(frozen=True)
class FrameCheck:
    """What became of one recorded frame.

    figures: head -> how far its answer is from the recorded one, see `runtime.io.agreement.compare`
    failed: the heads whose answers are farther than their limits allow
    faults: what else differs, in words; the figures of such a head are missing
    predict_ms: time it took now; None = no answer
    """

    frame: RecordedFrame
    figures: Mapping[str, Mapping[str, float]]
    failed: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    predict_ms: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the frame was answered as it was recorded."""
        return not self.failed and not self.faults


def verify(
    predictor: Predictor, recording: Recording, limits: Mapping[str, float]
) -> Iterator[FrameCheck]:
    """Predict each recorded frame, and yield how its answers compare with the recorded ones.

    limits: head -> limit of its first figure, for every head of the recording.
    Each new size of frame is predicted once before it counts. Raises InputError for a recording
    whose arrays are damaged.
    """
    warm = set()
    for index, frame in enumerate(recording.frames):
        arrays = recording.arrays(index)
        rgb, sparse_depth = arrays.pop("rgb"), arrays.pop("sparse_depth")
        try:
            if rgb.shape not in warm:
                predictor.predict(rgb, sparse_depth)
                warm.add(rgb.shape)
            prediction = predictor.predict(rgb, sparse_depth)
        except InferenceError as error:
            yield FrameCheck(frame, {}, faults=(str(error),))
            continue
        answers = prediction.heads
        faults = []
        if prediction.valid != frame.valid:
            faults.append(f"valid is {prediction.valid}, recorded was {frame.valid}")
        if frame.degraded is not None and prediction.degraded != frame.degraded:
            faults.append(
                f"degraded is {_named(prediction.degraded)}, recorded was {_named(frame.degraded)}"
            )
        if answers.keys() != recording.limits.keys():
            faults.append(f"answered {_named(answers)}, recorded was {_named(recording.limits)}")
        figures: dict[str, dict[str, float]] = {}
        for head in [head for head in predictor.heads if head in arrays]:
            answer, expected = answers[head], arrays[head]
            if answer.shape != expected.shape or not _is_number(expected):
                faults.append(
                    f"{head} is {answer.dtype} {answer.shape}, recorded was {expected.dtype} "
                    f"{expected.shape}"
                )
            else:
                figures[head] = compare(head, answer, expected)
        yield FrameCheck(
            frame,
            figures,
            tuple(
                h for h in recording.limits if h in figures and not within(h, figures[h], limits[h])
            ),
            tuple(faults),
            prediction.latency.total_ms,
        )


def slowdown(checks: Sequence[FrameCheck]) -> float | None:
    """Return the median time now over the recorded one; None where no times were recorded."""
    pairs = [
        (check.predict_ms, check.frame.predict_ms)
        for check in checks
        if check.predict_ms is not None and check.frame.predict_ms is not None
    ]
    if not pairs:
        return None
    now_ms, recorded_ms = zip(*pairs, strict=True)
    return float(statistics.median(now_ms) / max(statistics.median(recorded_ms), 1e-9))


def worst_figures(checks: Sequence[FrameCheck], head: str) -> dict[str, float] | None:
    """Return the worst of each figure of a head over all frames; None if no frame has any."""
    figures = [check.figures[head] for check in checks if head in check.figures]
    return worst(head, figures) if figures else None


def _named(names: Any) -> str:
    return ", ".join(names) or "nothing"


def _is_number(values: np.ndarray[Any, Any]) -> bool:
    return values.dtype.kind in "uif"
