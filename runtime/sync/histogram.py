"""Percentiles of a stream that runs for days, in memory that does not grow.

The buckets are those of HdrHistogram (hdrhistogram.org): as wide as the unit of 1 µs up to 2 ms,
then 1024 to each doubling, so that a percentile is at most a thousandth too high. Nothing is
clipped: the largest value is kept as it was, and values beyond three days share the last bucket.
"""

import numpy as np

from runtime.sync.latency import PERMILLE, LatencyStatistics

_UNITS_PER_MS = 1000
_BITS = 10  # 2^10 buckets to each doubling
_DOUBLINGS = 38 - _BITS  # up to 2^38 µs = 76 h


class DurationHistogram:
    """Counts durations [ms] in buckets; what is below zero counts as zero but in the mean."""

    def __init__(self) -> None:
        self._counts = np.zeros((_DOUBLINGS + 1) << _BITS, dtype=np.int64)
        self._n = 0
        self._sum_ms = 0.0
        self._max_ms = float("-inf")

    def record(self, duration_ms: float) -> None:
        """Count one more."""
        units = max(round(duration_ms * _UNITS_PER_MS), 0)
        shift = max(units.bit_length() - _BITS - 1, 0)
        index = (shift << _BITS) + (units >> shift)
        self._counts[min(index, len(self._counts) - 1)] += 1
        self._n += 1
        self._sum_ms += duration_ms
        self._max_ms = max(self._max_ms, duration_ms)

    def statistics(self) -> LatencyStatistics | None:
        """Statistics as `latency_statistics` has them; None if there is nothing."""
        if self._n == 0:
            return None
        cumulative = np.cumsum(self._counts)
        p90, p99, p99_9 = (
            self._percentile(cumulative, permille) if self._n * (1000 - permille) >= 1000 else None
            for permille in PERMILLE.values()
        )
        return LatencyStatistics(
            n=self._n,
            mean_ms=self._sum_ms / self._n,
            median_ms=self._percentile(cumulative, 500),
            p90_ms=p90,
            p99_ms=p99,
            p99_9_ms=p99_9,
            max_ms=self._max_ms,
        )

    def _percentile(self, cumulative: np.ndarray, permille: int) -> float:
        """The upper end of the bucket that holds the nearest rank."""
        rank = -(-self._n * permille // 1000)
        index = int(np.searchsorted(cumulative, max(rank, 1)))
        if index == len(cumulative) - 1:
            return self._max_ms
        shift = max((index >> _BITS) - 1, 0)
        upper = ((index - (shift << _BITS) + 1) << shift) - 1
        return min(upper / _UNITS_PER_MS, self._max_ms)
