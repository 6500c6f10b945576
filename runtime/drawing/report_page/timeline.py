"""Outcomes of the frames of a run over time, in bounded memory."""

from collections import Counter
from dataclasses import dataclass, field
from functools import reduce
from operator import add

_MAX_SPANS = 2048  # more than a screen has columns


@dataclass(frozen=True)
class Moment:
    """The outcome of one frame.

    Attributes:
        name: of the frame.
        response_ms: what the deadline limits; None = there was no answer.
        marks: its status unless "ok", "late", reasons of `Prediction.degraded`, findings of health.
        returns: LiDAR returns that were used; None = not known.
    """

    name: str
    response_ms: float | None = None
    marks: tuple[str, ...] = ()
    returns: int | None = None


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
    returns_known: int = 0

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
        """Mean number of returns; None = not known."""
        return self.returns / self.returns_known if self.returns_known else None

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
            returns_known=self.returns_known + later.returns_known,
        )


class Timeline:
    """Collects moments; in long runs several frames share a span."""

    def __init__(self) -> None:
        self.frames = 0
        self.marks: Counter[str] = Counter()  # mark -> frames that have it
        self.flagged = 0  # frames with any mark
        self._spans: list[Span] = []
        self._span_frames = 1  # frames a span

    def add(self, moment: Moment) -> None:
        """Add the next frame."""
        response = moment.response_ms
        span = Span(
            self.frames,
            self.frames,
            moment.name,
            answered=response is not None,
            low_ms=float("inf") if response is None else response,
            high_ms=response or 0.0,
            sum_ms=response or 0.0,
            marks=Counter(set(moment.marks)),
            returns=moment.returns or 0,
            returns_known=moment.returns is not None,
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
