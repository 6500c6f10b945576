"""Percentiles of a stream of any length in constant memory.

The buckets are those of HdrHistogram (hdrhistogram.org): 1 µs wide up to 2 ms, then 1024 to each
doubling, so that a percentile is at most 0.1 % too high. Nothing is clipped: the largest value is
kept exactly, and values beyond three days share the last bucket.
"""

import numpy as np

from runtime.sync.latency import LatencyStatistics, statistics_by_rank

_UNITS_PER_MS = 1000
_BITS = 10  # 2^10 buckets to each doubling
_DOUBLINGS = 38 - _BITS  # up to 2^38 µs = 76 h


class DurationHistogram:
    """Counts durations [ms] in buckets; negative ones count as zero, but not in the mean."""

    def __init__(self) -> None:
        self._counts = np.zeros((_DOUBLINGS + 1) << _BITS, dtype=np.int64)
        self._n = 0
        self._sum_ms = 0.0
        self._max_ms = float("-inf")

    def record(self, duration_ms: float) -> None:
        """Count one more duration."""
        units = max(round(duration_ms * _UNITS_PER_MS), 0)
        shift = max(units.bit_length() - _BITS - 1, 0)
        index = (shift << _BITS) + (units >> shift)
        self._counts[min(index, len(self._counts) - 1)] += 1
        self._n += 1
        self._sum_ms += duration_ms
        self._max_ms = max(self._max_ms, duration_ms)

    def statistics(self) -> LatencyStatistics | None:
        """Statistics as in `latency_statistics`; None if nothing was recorded."""
        cumulative = np.cumsum(self._counts)

        def at_rank(rank: int) -> float:
            """The upper end of the bucket that holds the rank."""
            index = int(np.searchsorted(cumulative, rank))
            if rank == self._n or index == len(cumulative) - 1:
                return self._max_ms
            shift = max((index >> _BITS) - 1, 0)
            upper = ((index - (shift << _BITS) + 1) << shift) - 1
            return min(upper / _UNITS_PER_MS, self._max_ms)

        return statistics_by_rank(self._n, self._sum_ms, at_rank)
