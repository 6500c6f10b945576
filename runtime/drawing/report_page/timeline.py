"""Outcomes of the frames of a run over time, in bounded memory."""

from collections import Counter
from dataclasses import dataclass, field
from functools import reduce
from operator import add

from runtime.sync.frame_outcome import OK, FrameOutcome

LATE = "late"
_MAX_SPANS = 2048  # more than a screen has columns


@dataclass
class Span:
    """Successive frames; the times are of the answered ones among them.

    Attributes:
        first: number of the first frame, from 0.
        last: number of the last frame.
        name: of the frame, if it is only one.
        marks: mark -> frames that have it.
    """

    first: int
    last: int
    name: str
    answered: int = 0
    low_ms: float = float("inf")
    high_ms: float = 0.0
    sum_ms: float = 0.0
    marks: Counter[str] = field(default_factory=Counter)
    returns: int = 0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.last - self.first + 1

    @property
    def middle(self) -> float:
        """Position of its middle."""
        return (self.first + self.last) / 2

    @property
    def mean_ms(self) -> float:
        """Mean latency; at least one frame must be answered."""
        return self.sum_ms / self.answered

    @property
    def mean_returns(self) -> float | None:
        """Mean number of returns used; None = no frame was answered."""
        return self.returns / self.answered if self.answered else None

    def __add__(self, later: "Span") -> "Span":
        """Join it with the span after it."""
        return Span(
            self.first,
            later.last,
            "",
            answered=self.answered + later.answered,
            low_ms=min(self.low_ms, later.low_ms),
            high_ms=max(self.high_ms, later.high_ms),
            sum_ms=self.sum_ms + later.sum_ms,
            marks=self.marks + later.marks,
            returns=self.returns + later.returns,
        )


class Timeline:
    """Collects the outcomes of frames; in long runs several frames share a span.

    Marks are the status unless "ok", "late", reasons of `Prediction.degraded`, and findings of
    health.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.marks: Counter[str] = Counter()  # mark -> frames that have it
        self.flagged = 0  # frames with any mark
        self._spans: list[Span] = []
        self._span_frames = 1  # frames a span

    def add(self, done: FrameOutcome) -> None:
        """Add the next frame."""
        answer, response = done.prediction, done.latency_ms
        marks = {*done.health, *(answer.degraded if answer else ())}
        if done.status != OK:
            marks.add(done.status)
        if done.deadline_met is False:
            marks.add(LATE)
        span = Span(
            self.frames,
            self.frames,
            done.name,
            answered=response is not None,
            low_ms=float("inf") if response is None else response,
            high_ms=response or 0.0,
            sum_ms=response or 0.0,
            marks=Counter(marks),
            returns=answer.depth_returns if answer else 0,
        )
        self.marks.update(span.marks)
        self.flagged += bool(span.marks)
        if self._spans and self._spans[-1].frames < self._span_frames:
            self._spans[-1] += span
        else:
            self._spans.append(span)
        self.frames += 1
        if len(self._spans) > _MAX_SPANS:
            self._spans = _by(self._spans, 2)
            self._span_frames *= 2

    def spans(self, at_most: int = _MAX_SPANS) -> list[Span]:
        """The spans in order, joined until they are at most `at_most`."""
        return _by(self._spans, -(-len(self._spans) // at_most) or 1)


def _by(spans: list[Span], several: int) -> list[Span]:
    return [reduce(add, spans[at : at + several]) for at in range(0, len(spans), several)]
