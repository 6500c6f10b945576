"""Statistics by hand and by their definition, and percentiles in bounded memory."""

import pickle
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.streams.statistics import (
    DurationHistogram,
    Jitter,
    StreamStatistics,
    latency_statistics,
)


@pytest.mark.parametrize(("n", "known"), [
    (1, 0), (2, 0), (9, 0), (10, 1), (99, 1), (100, 2), (101, 2), (999, 2), (1000, 3), (1001, 3),
])  # fmt: skip
def test_percentiles_against_their_definition_where_n_supports_them(n, known):
    durations_ms = np.random.default_rng(n).random(n).tolist()
    found = latency_statistics(durations_ms)
    ordered = sorted(durations_ms)
    expected = [ordered[-(-permille * n // 1000) - 1] for permille in (500, 900, 990, 999)]
    percentiles = [found.median_ms, found.p90_ms, found.p99_ms, found.p99_9_ms]
    assert percentiles == expected[: known + 1] + [None] * (3 - known)
    assert (found.n, found.max_ms) == (n, ordered[-1])
    assert latency_statistics([]) is None


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


# --- in bounded memory ---------------------------------------------------------------------------


def histogram_of(durations_ms):
    histogram = DurationHistogram()
    for duration_ms in durations_ms:
        histogram.record(duration_ms)
    return histogram


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0, 1e8), min_size=1, max_size=60))
def test_any_durations(durations_ms):
    found, exact = histogram_of(durations_ms).statistics(), latency_statistics(durations_ms)
    for value, expected in zip(astuple(found), astuple(exact), strict=True):
        close = None if expected is None else pytest.approx(expected, rel=1 / 1024, abs=0.6e-3)
        assert value == close
    assert (found.n, found.max_ms) == (exact.n, exact.max_ms)


def test_nothing_is_clipped_and_memory_does_not_grow():
    histogram = histogram_of([1.0] * 9)
    size = len(pickle.dumps(histogram))
    for huge in (1e12, -5.0):
        histogram.record(huge)
    statistics = histogram.statistics()
    assert (statistics.n, statistics.max_ms) == (11, 1e12)
    assert statistics.mean_ms == pytest.approx((9 + 1e12 - 5) / 11)
    assert len(pickle.dumps(histogram)) <= size + 100 < 300_000
