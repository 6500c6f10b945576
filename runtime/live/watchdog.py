"""The state of a stream, OK, WARN or ERROR, with its reasons."""

import math
from dataclasses import dataclass, fields
from enum import StrEnum

from runtime.checks import check_number, shown
from runtime.errors import InputError
from runtime.live.frame_result import FrameResult
from runtime.prediction import DEPTH_REUSED
from runtime.sync.stamp import NS_PER_MS

Limits = tuple[float | None, float | None]  # least values for WARN and for ERROR; None = never


class Level(StrEnum):
    """State of a stream."""

    NOT_YET = "n/a"  # no message yet
    OK = "OK"
    WARN = "WARN"
    ERROR = "ERROR"


@dataclass(frozen=True)
class WatchdogLimits:
    """Limits for WARN and for ERROR, a pair each; None = never.

    Attributes:
        late: results in a row that missed the deadline.
        degraded: results in a row with a reason in `Prediction.degraded`, other than
            "depth_reused", or in `FrameResult.health`.
        reused: results in a row with the depth of an older scan.
        failed: frames in a row that were an error or whose prediction is not valid.
        silence_ms: time since the last result, or else since the first message.

    Raises:
        InputError: if a limit is not such a pair.
    """

    late: Limits = (1, 5)
    degraded: Limits = (1, None)
    reused: Limits = (None, None)
    failed: Limits = (1, 3)
    silence_ms: Limits = (500, 2000)

    def __post_init__(self) -> None:
        """Check the limits."""
        for field in fields(self):
            pair = getattr(self, field.name)
            expected = f"{field.name} must be a pair (warn, error) of numbers or None"
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise InputError(f"{expected}, got {shown(pair)}")
            for limit in pair:
                if limit is not None:
                    check_number(f"{expected}: each", limit, 1e-6, math.inf, error=InputError)


@dataclass(frozen=True)
class WatchdogState:
    """State of a stream.

    Attributes:
        level: the worst of all limits that were reached.
        reasons: the names of those limits.
    """

    level: Level
    reasons: tuple[str, ...] = ()


class Watchdog:
    """Counts faults in a row. Times are arguments [ns]; the stream's lock guards it."""

    def __init__(self, limits: WatchdogLimits) -> None:
        self._limits = limits
        self._runs = {"late": 0, "degraded": 0, "reused": 0, "failed": 0}
        self._last_ns: int | None = None

    def start(self, now_ns: int) -> None:
        """A message was pushed; the first one ends "n/a"."""
        if self._last_ns is None:
            self._last_ns = now_ns

    def answered(self, result: FrameResult, now_ns: int) -> None:
        """A frame was answered."""
        self._last_ns = now_ns
        self._count(
            late=result.deadline_met is False,
            degraded=bool({*result.prediction.degraded} - {DEPTH_REUSED} or result.health),
            reused=result.depth_reused,
            failed=not result.prediction.valid,
        )

    def failed(self) -> None:
        """A frame was an error: there is no answer."""
        self._count(failed=True)

    def state(self, now_ns: int) -> WatchdogState:
        """The state at this moment."""
        if self._last_ns is None:
            return WatchdogState(Level.NOT_YET)
        silence_ms = (now_ns - self._last_ns) / NS_PER_MS
        figures: dict[str, float] = {**self._runs, "silence_ms": silence_ms}
        level, reasons = Level.OK, []
        for name, figure in figures.items():
            warn, error = getattr(self._limits, name)
            if error is not None and figure >= error:
                level = Level.ERROR
                reasons.append(name)
            elif warn is not None and figure >= warn:
                level = Level.WARN if level is Level.OK else level
                reasons.append(name)
        return WatchdogState(level, tuple(reasons))

    def due_ns(self, now_ns: int) -> int | None:
        """When silence changes the state next; None = never."""
        if self._last_ns is None:
            return None
        limits_ns = [
            self._last_ns + round(limit * NS_PER_MS)
            for limit in self._limits.silence_ms
            if limit is not None
        ]
        return min((limit_ns for limit_ns in limits_ns if limit_ns > now_ns), default=None)

    def _count(self, **wrong: bool) -> None:
        for name, is_wrong in wrong.items():
            self._runs[name] = self._runs[name] + 1 if is_wrong else 0
