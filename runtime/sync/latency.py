"""Latency statistics that say no more than the number of frames supports."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

# A percentile needs at least one frame beyond it: 10 for p90, 100 for p99, 1000 for p99.9.
PERMILLE = {"p90_ms": 900, "p99_ms": 990, "p99_9_ms": 999}


@dataclass(frozen=True)
class LatencyStatistics:
    """How long a stage took over n frames [ms]. Percentiles are by nearest rank, none is clipped.

    A percentile is None where n is too small for it.
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
    """Statistics of some durations [ms]; None if there are none."""
    ordered = sorted(durations_ms)
    n = len(ordered)
    if n == 0:
        return None
    p90, p99, p99_9 = (
        nearest_rank(ordered, permille) if n * (1000 - permille) >= 1000 else None
        for permille in PERMILLE.values()
    )
    return LatencyStatistics(
        n=n,
        mean_ms=sum(ordered) / n,
        median_ms=nearest_rank(ordered, 500),
        p90_ms=p90,
        p99_ms=p99,
        p99_9_ms=p99_9,
        max_ms=ordered[-1],
    )


def nearest_rank(ordered: Sequence[float], permille: int) -> float:
    """The smallest value with at least `permille` thousandths of all values at or below it.

    ordered: ascending, at least one value.
    """
    rank = -(-len(ordered) * permille // 1000)  # rounded up, in integers
    return ordered[max(rank, 1) - 1]


def missed_deadlines(latencies_ms: Iterable[float], *, deadline_ms: float) -> MissedDeadlines:
    """Count the latencies [ms] above the deadline; exactly on it is in time.

    Frames without a prediction have no latency: they neither count nor end a run of late ones.
    """
    count = run = longest = 0
    for latency_ms in latencies_ms:
        run = run + 1 if latency_ms > deadline_ms else 0
        count += run > 0
        longest = max(longest, run)
    return MissedDeadlines(count=count, longest_run=longest)


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
