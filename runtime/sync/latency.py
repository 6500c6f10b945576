"""Latency statistics that say no more than the number of frames supports."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from runtime.sync.stamp import NS_PER_MS


@dataclass(frozen=True)
class LatencyStatistics:
    """How long a stage took over n frames [ms]. Percentiles are by nearest rank, none is clipped.

    A percentile is None where no frame lies beyond it: it takes 10 frames for p90, 100 for p99 and
    1000 for p99.9.
    """

    n: int
    mean_ms: float
    median_ms: float
    p90_ms: float | None
    p99_ms: float | None
    p99_9_ms: float | None
    max_ms: float


@dataclass(frozen=True)
class MissedDeadlines:
    """How many frames took longer than the deadline, and how many of them in a row."""

    count: int
    longest_run: int


def latency_statistics(durations_ms: Iterable[float]) -> LatencyStatistics | None:
    """Exact statistics of some durations [ms]; None if there are none."""
    ordered = sorted(durations_ms)
    return statistics_by_rank(len(ordered), sum(ordered), lambda rank: ordered[rank - 1])


def statistics_by_rank(
    n: int, sum_ms: float, at_rank: Callable[[int], float]
) -> LatencyStatistics | None:
    """Statistics of n durations; None for n = 0.

    at_rank: returns the duration of a rank [ms]; 1 is the shortest, n the longest
    """
    if n == 0:
        return None

    def percentile(permille: int) -> float | None:
        """The shortest duration that permille thousandths of all do not exceed."""
        if n * (1000 - permille) < 1000:
            return None
        return at_rank(-(-n * permille // 1000))  # rounded up, in integers

    return LatencyStatistics(
        n=n,
        mean_ms=sum_ms / n,
        median_ms=at_rank(-(-n // 2)),
        p90_ms=percentile(900),
        p99_ms=percentile(990),
        p99_9_ms=percentile(999),
        max_ms=at_rank(n),
    )


class MissCounter:
    """Counts the answers that missed the deadline, and the longest run of them.

    Frames without an answer have no latency: they neither count nor end a run.
    """

    def __init__(self) -> None:
        self._count = self._run = self._longest_run = 0

    def record(self, late: bool) -> None:
        """Count one more answer."""
        self._run = self._run + 1 if late else 0
        self._count += late
        self._longest_run = max(self._longest_run, self._run)

    def misses(self) -> MissedDeadlines:
        """The counts so far."""
        return MissedDeadlines(self._count, self._longest_run)


class Jitter:
    """The transit-time difference of RFC 3550 between successive answers."""

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def record(self, transit_ns: int) -> float | None:
        """Return |this - last| [ms]; None for the first.

        transit_ns: time of the answer - time of the frame, each by its own clock
        """
        last_ns, self._last_ns = self._last_ns, transit_ns
        return None if last_ns is None else abs(transit_ns - last_ns) / NS_PER_MS

    def reset(self) -> None:
        """The clock of the frames was set anew: the next answer has no jitter."""
        self._last_ns = None


def latency_table(stages: dict[str, LatencyStatistics | None]) -> str:
    """A text table, a line a stage; "n/a" where there is nothing or n is too small [ms]."""
    columns = ("n", "mean", "median", "p90", "p99", "p99.9", "max")
    width = max(len(stage) for stage in stages)
    lines = ["stage [ms]".ljust(max(width, 10)) + "".join(f"{column:>9}" for column in columns)]
    for stage, statistics in stages.items():
        cells = (
            [str(statistics.n), *map(_cell, _times(statistics))]
            if statistics is not None
            else ["0", *["n/a"] * 6]
        )
        lines.append(stage.ljust(max(width, 10)) + "".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)


def _times(statistics: LatencyStatistics) -> tuple[float | None, ...]:
    return (
        statistics.mean_ms,
        statistics.median_ms,
        statistics.p90_ms,
        statistics.p99_ms,
        statistics.p99_9_ms,
        statistics.max_ms,
    )


def _cell(duration_ms: float | None) -> str:
    return "n/a" if duration_ms is None else f"{duration_ms:.2f}"
