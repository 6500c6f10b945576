"""Counts of a stream or a replay: messages by outcome, figures of the answers, faults in a row.

The faults in a row and the silence of a stream decide whether its state is OK, WARN or ERROR.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field, fields
from enum import StrEnum

from runtime.base.arguments import check_number, shown
from runtime.base.errors import InferenceError, InputError, SSDNetError
from runtime.base.stamp import NS_PER_MS
from runtime.contract.degraded import DEPTH_REUSED
from runtime.streams.frame_result import FIGURES, FrameResult
from runtime.streams.matching import Discarded, Pair
from runtime.streams.messages import DROPPED, ERRORS, UNMATCHED, Message, Outcome, Sensor
from runtime.streams.statistics import DurationHistogram, MissCounter, StreamStatistics

Limits = tuple[float | None, float | None]  # least values for WARN and for ERROR; None = never
_FAULTS = ("late", "degraded", "reused", "failed")  # fields of `WatchdogLimits`


@dataclass(frozen=True)
class MessageCounts:
    """Messages by outcome: `pushed` is the sum of all the others.

    Attributes:
        pushed: all messages.
        answered: messages that are part of an answer.
        dropped, unmatched, errors: reason -> messages, see `Outcome`.
    """

    pushed: int = 0
    answered: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    unmatched: Mapping[str, int] = field(default_factory=dict)
    errors: Mapping[str, int] = field(default_factory=dict)

    @property
    def pending(self) -> int:
        """Messages that are still waiting or being answered; 0 at the end."""
        reasons = (self.dropped, self.unmatched, self.errors)
        return self.pushed - self.answered - sum(sum(counts.values()) for counts in reasons)


@dataclass(frozen=True, kw_only=True)
class StreamCounts(MessageCounts):
    """Messages of both sensors together: an answer made of an image and a depth map is two.

    Attributes:
        images, depths: counts of each sensor; `images.answered` is the number of answers.
        poses: counts of the poses; a pose that was accepted is "answered".
        camera_only: answers without depth.
        reused: answers with the depth of an older scan. The scan is counted once, as part of the
            answer with its own image, or as "reused" if it has no image.
        jumps_back: how often the stamps of a sensor jumped back by more than a second.
    """

    images: MessageCounts
    depths: MessageCounts
    poses: MessageCounts
    camera_only: int
    reused: int
    jumps_back: int


class WatchdogLevel(StrEnum):
    """State of a stream."""

    NOT_YET = "n/a"  # no message yet
    OK = "OK"
    WARN = "WARN"
    ERROR = "ERROR"


@dataclass(frozen=True)
class WatchdogState:
    """State of a stream.

    Attributes:
        level: the worst of all limits that were reached.
        reasons: the names of those limits.
    """

    level: WatchdogLevel
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class WatchdogLimits:
    """Limits as pairs (for WARN, for ERROR); None: never.

    Attributes:
        late: results in a row that missed the deadline.
        degraded: results in a row with a reason in `Prediction.degraded`, other than
            "depth_reused", or in `FrameResult.health`.
        reused: results in a row with the depth of an older scan.
        failed: frames in a row that were an error or whose prediction is not valid.
        silence_ms: time since the last result, or since the first message if there is no result.
        camera_silent: time since the last image, or since the first message [ms].
        lidar_silent: time since the last scan or depth map [ms], after the first one. By default
            this is no error, because images without depth are still answered.

    Raises:
        InputError: if a limit is no such pair.
    """

    late: Limits = (1, 5)
    degraded: Limits = (1, None)
    reused: Limits = (None, None)
    failed: Limits = (1, 3)
    silence_ms: Limits = (500, 2000)
    camera_silent: Limits = (500, 2000)
    lidar_silent: Limits = (500, None)

    def __post_init__(self) -> None:
        """Check the limits."""
        for each in fields(self):
            pair = getattr(self, each.name)
            expected = f"{each.name} must be a pair (warn, error) of numbers or None"
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise InputError(f"{expected}, got {shown(pair)}")
            for limit in pair:
                if limit is not None:
                    check_number(f"{expected}: each", limit, 1e-6, math.inf, error=InputError)

    def state(self, figures: Mapping[str, float]) -> WatchdogState:
        """Return the state for these figures: name of a limit -> present value."""
        level, reasons = WatchdogLevel.OK, []
        for name, figure in figures.items():
            warn, error = (math.inf if each is None else each for each in getattr(self, name))
            if figure >= min(warn, error):
                reasons.append(name)
                is_error = figure >= error or level is WatchdogLevel.ERROR
                level = WatchdogLevel.ERROR if is_error else WatchdogLevel.WARN
        return WatchdogState(level, tuple(reasons))


class StreamCounter:
    """Counts every message when it comes and when its outcome is known, and every answer.

    Memory is constant. Not thread-safe. Times are by the clock of a live stream [ns].

    Args:
        deadline_ms: deadline of the stream; None: no limit.
        limits: limits for `state`; None: the default limits.
    """

    def __init__(
        self, deadline_ms: float | None = None, limits: WatchdogLimits | None = None
    ) -> None:
        self._deadline_ms, self._limits = deadline_ms, limits or WatchdogLimits()
        self._pushed: Counter[Sensor] = Counter()
        self._outcomes: dict[Sensor, Counter[Outcome]] = {sensor: Counter() for sensor in Sensor}
        self._camera_only = self._reused = self._jumps_back = 0
        self._histograms = {name: DurationHistogram() for name in FIGURES}
        self._faults = {name: MissCounter() for name in _FAULTS}
        self._is_started = False  # a message was accepted, or a frame answered
        # Limit on silence -> since when: the last answer or message, or else the first message.
        self._since_ns: dict[str, int] = {}

    def push(self, sensor: Sensor, outcome: Outcome | None = None) -> None:
        """Count a new message, and its outcome if it is known at once."""
        self._pushed[sensor] += 1
        if outcome is not None:
            self._outcomes[sensor][outcome] += 1

    def record_accepted(self, sensor: Sensor, now_ns: int) -> None:
        """Record that a message was accepted; the first one ends the state "n/a"."""
        self._is_started = True
        self._since_ns.setdefault("silence_ms", now_ns)
        self._since_ns.setdefault("camera_silent", now_ns)
        if sensor is not Sensor.POSE:
            self._since_ns["camera_silent" if sensor is Sensor.IMAGE else "lidar_silent"] = now_ns

    def record_discarded(
        self, discarded: Iterable[Discarded[Message]], *, jumped_back: bool
    ) -> None:
        """Count what a step of the matching discarded, and whether the stamps jumped back."""
        for message, outcome in discarded:
            self._outcomes[message.sensor][outcome] += 1
        self._jumps_back += jumped_back

    def record_pair(self, pair: Pair[Message], outcome: Outcome, times: int = 1) -> None:
        """Count the outcome of an image and of its own depth; times=-1 subtracts it again."""
        self._outcomes[Sensor.IMAGE][outcome] += times
        if pair.own_depth is not None:
            self._outcomes[Sensor.DEPTH][outcome] += times
        elif outcome is Outcome.ANSWERED:
            self._reused += times * pair.reused
            self._camera_only += times * (not pair.reused)

    def record_answer(
        self, pair: Pair[Message], result: FrameResult, now_ns: int | None = None
    ) -> None:
        """Record the answer to a pair. A replay passes no time, so it is never silent."""
        self._is_started = True
        self.record_pair(pair, Outcome.ANSWERED)
        for name, histogram in self._histograms.items():
            if (value_ms := FIGURES[name](result)) is not None:
                histogram.record(value_ms)
        if now_ns is not None:
            self._since_ns["silence_ms"] = now_ns
        doubts = {*result.prediction.degraded, *result.health} - {DEPTH_REUSED}
        self._faults["late"].record(result.deadline_met is False)
        self._faults["degraded"].record(bool(doubts))
        self._faults["reused"].record(result.depth_reused)
        self._faults["failed"].record(not result.prediction.valid)

    def record_failed(self, pair: Pair[Message], error: BaseException) -> None:
        """Record a pair that ended with an error instead of an answer."""
        self._is_started = True
        self._faults["failed"].record(True)
        is_input = isinstance(error, SSDNetError) and not isinstance(error, InferenceError)
        self.record_pair(pair, Outcome.INPUT_ERROR if is_input else Outcome.INFERENCE_ERROR)

    def record_unread(self, pair: Pair[Message]) -> None:
        """Count the messages of an answer as dropped, because it was not fetched."""
        self.record_pair(pair, Outcome.ANSWERED, -1)
        self.record_pair(pair, Outcome.UNREAD)

    @property
    def counts(self) -> StreamCounts:
        """A copy of the present counts."""
        both = self._outcomes[Sensor.IMAGE] + self._outcomes[Sensor.DEPTH]
        pushed = self._pushed[Sensor.IMAGE] + self._pushed[Sensor.DEPTH]
        return StreamCounts(
            **vars(_counts(pushed, both)),
            images=_counts(self._pushed[Sensor.IMAGE], self._outcomes[Sensor.IMAGE]),
            depths=_counts(self._pushed[Sensor.DEPTH], self._outcomes[Sensor.DEPTH]),
            poses=_counts(self._pushed[Sensor.POSE], self._outcomes[Sensor.POSE]),
            camera_only=self._camera_only,
            reused=self._reused,
            jumps_back=self._jumps_back,
        )

    @property
    def statistics(self) -> StreamStatistics:
        """Statistics of the answers so far."""
        stages = {name: each.statistics() for name, each in self._histograms.items()}
        missed = None if self._deadline_ms is None else self._faults["late"].misses()
        return StreamStatistics(stages, self._deadline_ms, missed)

    def state(self, now_ns: int) -> WatchdogState:
        """Return the present state; silence counts only in a live stream."""
        if not self._is_started:
            return WatchdogState(WatchdogLevel.NOT_YET)
        figures: dict[str, float] = {name: fault.run for name, fault in self._faults.items()}
        for name, since_ns in self._since_ns.items():
            figures[name] = (now_ns - since_ns) / NS_PER_MS
        return self._limits.state(figures)

    def due_ns(self, now_ns: int) -> int | None:
        """Return when silence changes the state next; None: never."""
        limits_ns = [
            since_ns + round(limit * NS_PER_MS)
            for name, since_ns in self._since_ns.items()
            for limit in getattr(self._limits, name)
            if limit is not None
        ]
        return min((limit_ns for limit_ns in limits_ns if limit_ns > now_ns), default=None)


def _counts(pushed: int, outcomes: Counter[Outcome]) -> MessageCounts:
    def of(kind: Set[Outcome]) -> dict[str, int]:
        return {outcome.value: count for outcome, count in outcomes.items() if outcome in kind}

    return MessageCounts(pushed, outcomes[Outcome.ANSWERED], of(DROPPED), of(UNMATCHED), of(ERRORS))
