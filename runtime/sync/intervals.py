"""The intervals between the stamps of a sensor."""

from collections import deque
from statistics import median_low

from runtime.sync.stamp import JUMP_BACK_NS

_REMEMBERED = 16  # latest intervals
_KNOWN = 5  # intervals from which the period is known


class Intervals:
    """The latest intervals of a sensor; they start anew where its stamps jump back.

    Attributes:
        newest_ns: the newest stamp; None before the first one.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self._intervals: deque[int] = deque(maxlen=_REMEMBERED)

    def add(self, stamp_ns: int) -> None:
        """Take the stamp of a message, of any order."""
        newest_ns = self.newest_ns
        if newest_ns is None or stamp_ns < newest_ns - JUMP_BACK_NS:
            self._intervals.clear()
        elif stamp_ns > newest_ns:
            self._intervals.append(stamp_ns - newest_ns)
        else:
            return
        self.newest_ns = stamp_ns

    @property
    def shortest_ns(self) -> int:
        """The shortest interval; 0 before the first one."""
        return min(self._intervals, default=0)

    def period_ns(self) -> int | None:
        """The median interval; None before `_KNOWN` intervals."""
        return median_low(self._intervals) if len(self._intervals) >= _KNOWN else None

    def spread_ns(self) -> int:
        """Mean distance from the period of the intervals that are one period long."""
        period_ns = self.period_ns()
        if period_ns is None:
            return 0
        single = [each for each in self._intervals if each < 1.5 * period_ns]
        return sum(abs(each - period_ns) for each in single) // len(single)
