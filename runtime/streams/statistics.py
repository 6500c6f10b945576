"""Latency statistics: percentiles, deadline misses, jitter."""

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, astuple, dataclass
from itertools import accumulate
from typing import Any

from runtime.base.stamp import NS_PER_MS

_GROWTH = math.log1p(1 / 1024)  # log ratio of a bucket to the one before
_LEAST_MS = 1e-4


@dataclass(frozen=True)
class LatencyStatistics:
    """Durations of a stage over n frames, in milliseconds; no outlier is clipped.

    Attributes:
        n: frames.
        mean_ms, median_ms, max_ms: over all frames.
        p90_ms, p99_ms, p99_9_ms: percentiles by nearest rank; None if there are fewer than 10, 100
            or 1000 frames, so that no frame could lie beyond the percentile.
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
    """Frames that took longer than the deadline.

    Attributes:
        count: number of late frames.
        longest_run: largest number of late frames in a row.
    """

    count: int
    longest_run: int


def latency_statistics(durations_ms: Iterable[float]) -> LatencyStatistics | None:
    """Return the exact statistics of some durations in milliseconds; None if there are none."""
    ordered = sorted(durations_ms)
    return statistics_by_rank(len(ordered), sum(ordered), lambda rank: ordered[rank - 1])


def statistics_by_rank(
    n: int, sum_ms: float, at_rank: Callable[[int], float]
) -> LatencyStatistics | None:
    """Return statistics of n durations [ms]; `at_rank` returns them from shortest to longest."""
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


class DurationHistogram:
    """Counts durations [ms] in buckets that grow by 1/1024; nothing is clipped.

    Memory is constant. A percentile is at most 0.1 % too high, and never below 0.1 µs. Number, mean
    and maximum are exact.
    """

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()  # exponent of a bucket's upper end -> durations
        self._n, self._sum_ms, self._max_ms = 0, 0.0, -math.inf

    def record(self, duration_ms: float) -> None:
        """Count one more duration."""
        self._counts[math.ceil(math.log(max(duration_ms, _LEAST_MS)) / _GROWTH)] += 1
        self._n += 1
        self._sum_ms += duration_ms
        self._max_ms = max(self._max_ms, duration_ms)

    def statistics(self) -> LatencyStatistics | None:
        """Statistics as in `latency_statistics`; None if nothing was recorded."""
        buckets = sorted(self._counts)
        cumulative = list(accumulate(self._counts[bucket] for bucket in buckets))

        def at_rank(rank: int) -> float:
            upper_ms = math.exp(_GROWTH * buckets[bisect_left(cumulative, rank)])
            return self._max_ms if rank == self._n else min(upper_ms, self._max_ms)

        return statistics_by_rank(self._n, self._sum_ms, at_rank)


class MissCounter:
    """Counts answers that missed the deadline or have another fault, and their longest run.

    Frames without an answer have no latency: they neither count nor end a run.

    Attributes:
        run: faults in a row up to now.
    """

    def __init__(self) -> None:
        self._count = self.run = self._longest_run = 0

    def record(self, missed: bool) -> None:
        """Count one more answer."""
        self.run = self.run + 1 if missed else 0
        self._count += missed
        self._longest_run = max(self._longest_run, self.run)

    def misses(self) -> MissedDeadlines:
        """The counts so far."""
        return MissedDeadlines(self._count, self._longest_run)


class Jitter:
    """The transit-time difference of RFC 3550 between successive answers."""

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def record(self, transit_ns: int) -> float | None:
        """Return |this - last| [ms], or None at first; `transit_ns` is time of answer - stamp."""
        last_ns, self._last_ns = self._last_ns, transit_ns
        return None if last_ns is None else abs(transit_ns - last_ns) / NS_PER_MS

    def reset(self) -> None:
        """Forget the last answer, because the stamps jumped; the next answer has no jitter."""
        self._last_ns = None


@dataclass(frozen=True)
class StreamStatistics:
    """Statistics of the frames of a run or a stream.

    Attributes:
        stages: figure of `FIGURES` -> statistics in milliseconds, None without a value.
        deadline_ms: the deadline; None: there is none.
        missed: late answers; None if there is no deadline.
    """

    stages: dict[str, LatencyStatistics | None]
    deadline_ms: float | None
    missed: MissedDeadlines | None

    def to_dict(self) -> dict[str, Any]:
        """Return the entries "stages" and "deadline" of a report.json, ready for `json.dumps`."""
        stages = {name: figures and asdict(figures) for name, figures in self.stages.items()}
        missed = self.missed and {"deadline_ms": self.deadline_ms, **asdict(self.missed)}
        return {"stages": stages, "deadline": missed}

    def table(self) -> str:
        """Return a text table with a line for each figure; "n/a" if there are too few frames."""
        columns = ("n", "mean", "median", "p90", "p99", "p99.9", "max")
        width = max(len(stage) for stage in (*self.stages, "stage [ms]"))
        lines = ["stage [ms]".ljust(width) + "".join(f"{column:>9}" for column in columns)]
        for stage, figures in self.stages.items():
            n, *times_ms = (0, *[None] * 6) if figures is None else astuple(figures)
            cells = [str(n), *("n/a" if each is None else f"{each:.2f}" for each in times_ms)]
            lines.append(stage.ljust(width) + "".join(f"{cell:>9}" for cell in cells))
        if self.missed is not None:
            run = f"longest run {self.missed.longest_run}"
            lines.append(f"missed deadlines of {self.deadline_ms:g} ms: {self.missed.count}, {run}")
        return "\n".join(lines)
