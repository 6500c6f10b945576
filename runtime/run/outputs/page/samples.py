"""Pictures of a few frames of a run: evenly spaced, the slowest, and the first flagged ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.io.encode import encode_jpeg
from runtime.prediction import Prediction

_EVEN, _FLAGGED = 6, 3  # most samples of each kind
_PANELS, _WIDEST = 3, 480  # image and first two heads; columns
_JPEG_QUALITY = 82


@dataclass(frozen=True)
class Sample:
    """One frame: number, name, latency, marks, and (title, JPEG) of its panels."""

    index: int
    name: str
    predict_ms: float
    marks: tuple[str, ...]
    panels: tuple[tuple[str, bytes], ...]
    slowest: bool = False


class SampleKeeper:
    """Keeps pictures of a few frames of a stream of any length."""

    def __init__(self, contract: Contract) -> None:
        self._overlay = Overlay(contract.classes, contract.max_depth_m)
        self._seen = 0
        self._step = 1
        self._even: list[Sample] = []
        self._flagged: dict[tuple[str, ...], Sample] = {}  # the first of each kind
        self._slowest: Sample | None = None

    def add(
        self,
        name: str,
        rgb: NDArray[np.uint8],
        prediction: Prediction,
        marks: Sequence[str] = (),
    ) -> None:
        """Add a frame; it is drawn only if it is kept.

        Args:
            name: of the frame.
            rgb: its image.
            prediction: its answer.
            marks: findings besides `prediction.degraded`.
        """
        index, self._seen = self._seen, self._seen + 1
        reasons = (*prediction.degraded, *marks)
        time_ms = prediction.latency.total_ms
        even = index % self._step == 0
        slowest = self._slowest is None or time_ms > self._slowest.predict_ms
        flagged = bool(reasons) and reasons not in self._flagged and len(self._flagged) < _FLAGGED
        if not (even or slowest or flagged):
            return
        drawn = self._overlay.panels(rgb, prediction, widest=_WIDEST)
        panels = tuple(
            (title, bytes(encode_jpeg(panel, quality=_JPEG_QUALITY)))
            for title, panel in list(drawn.items())[:_PANELS]
        )
        sample = Sample(index, name, time_ms, reasons, panels)
        if slowest:
            self._slowest = sample
        if flagged:
            self._flagged[reasons] = sample
        if even:
            self._even.append(sample)
            if len(self._even) > _EVEN:
                self._even = self._even[::2]
                self._step *= 2

    def samples(self) -> list[Sample]:
        """The kept frames, in order."""
        kept = {sample.index: sample for sample in (*self._even, *self._flagged.values())}
        if self._slowest is not None:
            kept[self._slowest.index] = replace(self._slowest, slowest=self._seen > 1)
        return [kept[index] for index in sorted(kept)]
