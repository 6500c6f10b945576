"""Axes of latency charts: positions of values and ticks."""

import math

_LOG_FROM = 12.0  # the axis is logarithmic if maximum / median is larger


class Axis:
    """Values [ms] to 0..1, linear from 0, or logarithmic where a few values are far off."""

    def __init__(
        self, lowest: float, median: float, highest: float, deadline_ms: float | None
    ) -> None:
        if deadline_ms is not None:
            lowest, highest = min(lowest, deadline_ms), max(highest, deadline_ms)
        self.logarithmic = highest > _LOG_FROM * median and lowest > 0
        if self.logarithmic:
            self._low, self._high = _step_below(lowest), _step_above(highest)
            self.ticks = _steps_between(self._low, self._high)
        else:
            step = _step_above(highest / 5)
            self._low, self._high = 0.0, step * max(math.ceil(highest / step - 1e-9), 1)
            self.ticks = [step * tick for tick in range(round(self._high / step) + 1)]

    @property
    def unit(self) -> str:
        """Text beside the axis."""
        return "ms, logarithmic" if self.logarithmic else "ms"

    def place(self, value: float) -> float:
        """0 at the lower end, 1 at the upper one."""
        if self.logarithmic:
            return math.log(max(value, self._low) / self._low) / math.log(self._high / self._low)
        return (value - self._low) / (self._high - self._low)


def frame_ticks(last: int, at_most: int) -> list[int]:
    """Numbers of frames to write below an axis from 0 to `last`."""
    step = max(round(_step_above(last / max(at_most, 1))), 1)
    return list(range(0, last + 1, step))


def _step_above(value: float) -> float:
    """The next of 1, 2, 5, 10, 20, 50 … at or above `value`, which is above 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * step for step in (1, 2, 5, 10) if power * step >= value * (1 - 1e-9))


def _step_below(value: float) -> float:
    """The next of 1, 2, 5, 10, 20, 50 … at or below `value`, which is above 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(power * step for step in (5, 2, 1) if power * step <= value * (1 + 1e-9))


def _steps_between(low: float, high: float) -> list[float]:
    ticks = [low]
    while ticks[-1] < high * (1 - 1e-9):
        ticks.append(_step_above(ticks[-1] * 1.01))
    return ticks
