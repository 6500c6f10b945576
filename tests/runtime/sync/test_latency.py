"""Statistics by hand, and no percentile that n cannot support."""

import numpy as np
import pytest

from runtime.sync.latency import (
    Jitter,
    MissCounter,
    MissedDeadlines,
    StreamStatistics,
    latency_statistics,
)


def test_percentiles_are_the_nearest_rank():
    ordered = [15, 20, 35, 40, 50] * 20  # the example of Wikipedia's article on percentiles
    statistics = latency_statistics(ordered)
    assert (statistics.median_ms, statistics.p90_ms, statistics.p99_ms) == (35, 50, 50)
    assert latency_statistics([15, 20, 35, 40]).median_ms == 20


@pytest.mark.parametrize("n", [1, 2, 9, 10, 99, 100, 101, 999, 1000, 1001])
def test_percentiles_against_their_definition(n):
    durations_ms = np.random.default_rng(n).random(n).tolist()
    statistics = latency_statistics(durations_ms)
    found = {
        500: statistics.median_ms,
        900: statistics.p90_ms,
        990: statistics.p99_ms,
        999: statistics.p99_9_ms,
    }
    ordered = sorted(durations_ms)
    for permille, value in found.items():
        enough = (v for v in ordered if sum(w <= v for w in ordered) * 1000 >= permille * n)
        assert value in (None, next(enough))


def test_statistics_of_a_hundred():
    statistics = latency_statistics(reversed(range(1, 101)))
    assert (statistics.n, statistics.mean_ms, statistics.median_ms) == (100, 50.5, 50)
    assert (statistics.p90_ms, statistics.p99_ms, statistics.max_ms) == (90, 99, 100)
    assert statistics.p99_9_ms is None


@pytest.mark.parametrize(
    ("n", "known"),
    [(1, 0), (9, 0), (10, 1), (99, 1), (100, 2), (999, 2), (1000, 3)],
)
def test_percentiles_that_n_cannot_support_are_not_given(n, known):
    statistics = latency_statistics([1.0] * n)
    given = [statistics.p90_ms, statistics.p99_ms, statistics.p99_9_ms]
    assert given == [1.0] * known + [None] * (3 - known)


def test_outliers_are_not_clipped():
    assert latency_statistics([1.0] * 99 + [1e6]).max_ms == 1e6
    assert latency_statistics([]) is None


def test_missed_deadlines_and_their_longest_run():
    counter = MissCounter()
    assert counter.misses() == MissedDeadlines(0, 0)
    for late in (True, True, False, True, True, True, False, True):
        counter.record(late)
    assert counter.misses() == MissedDeadlines(count=6, longest_run=3)


def test_jitter_is_the_change_of_the_transit_time():
    jitter = Jitter()
    transits_ns = [2**60, 2**60 + 30_000_000, 2**60 + 10_000_000]  # clocks that began elsewhere
    assert [jitter.record(transit_ns) for transit_ns in transits_ns] == [None, 30, 20]
    jitter.reset()
    assert jitter.record(0) is None


def test_the_table_has_n_a_without_a_value():
    stages = {"read": latency_statistics([1.0, 2.0]), "write": None}
    table = StreamStatistics(stages, deadline_ms=None, missed=None).table()
    header, read, write = table.splitlines()
    assert header.split()[2:] == ["n", "mean", "median", "p90", "p99", "p99.9", "max"]
    assert read.split() == ["read", "2", "1.50", "1.00", "n/a", "n/a", "n/a", "2.00"]
    assert write.split() == ["write", "0", *["n/a"] * 6]
    assert len({len(line) for line in table.splitlines()}) == 1
