"""The state of a stream, OK, WARN or ERROR, with its reasons, and its limits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum

from runtime.checks import check_number, shown
from runtime.errors import InputError

Limits = tuple[float | None, float | None]  # least values for WARN and for ERROR; None = never


class Level(StrEnum):
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

    level: Level
    reasons: tuple[str, ...] = ()


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

    def state(self, figures: Mapping[str, float]) -> WatchdogState:
        """Return the state by the figures of the limits."""
        level, reasons = Level.OK, []
        for name, figure in figures.items():
            warn, error = getattr(self, name)
            if error is not None and figure >= error:
                level = Level.ERROR
                reasons.append(name)
            elif warn is not None and figure >= warn:
                level = Level.WARN if level is Level.OK else level
                reasons.append(name)
        return WatchdogState(level, tuple(reasons))
