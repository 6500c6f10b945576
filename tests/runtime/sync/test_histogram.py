"""Percentiles in bounded memory against the exact ones."""

import pickle
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.sync.histogram import DurationHistogram
from runtime.sync.latency import latency_statistics

US = 1e-3


def histogram_of(durations_ms):
    histogram = DurationHistogram()
    for duration_ms in durations_ms:
        histogram.record(duration_ms)
    return histogram


def check(durations_ms):
    found = histogram_of(durations_ms).statistics()
    exact = latency_statistics(durations_ms)
    for value, expected in zip(astuple(found), astuple(exact), strict=True):
        if expected is None:
            assert value is None
        else:
            assert value == pytest.approx(expected, rel=1 / 1024, abs=0.6 * US)
    assert (found.n, found.max_ms) == (exact.n, exact.max_ms)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0, 1e8), min_size=1, max_size=60))
def test_any_durations(durations_ms):
    check(durations_ms)


@pytest.mark.parametrize("n", [9, 10, 99, 100, 1000, 2500])
def test_each_percentile_appears_when_n_supports_it(n):
    check(np.random.default_rng(n).lognormal(3, 2, n).tolist())


def test_the_edges_of_the_buckets():
    for units in [*range(2040, 2060), *range(4090, 4102), 2**20 - 1, 2**20, 2**20 + 1]:
        statistics = histogram_of([units * US, units * US, 1e9]).statistics()
        assert units <= round(statistics.median_ms / US, 6) <= units * (1 + 1 / 1024)


def test_nothing_is_clipped_and_memory_does_not_grow():
    histogram = histogram_of([1.0] * 9)
    size = len(pickle.dumps(histogram))
    for huge in (1e12, -5.0):
        histogram.record(huge)
    statistics = histogram.statistics()
    assert statistics.max_ms == 1e12
    assert statistics.n == 11
    assert statistics.mean_ms == pytest.approx((9 + 1e12 - 5) / 11)
    assert len(pickle.dumps(histogram)) <= size + 100 < 300_000
    assert histogram_of([1e12] * 3).statistics().median_ms == 1e12


def test_nothing_recorded_has_no_statistics():
    assert DurationHistogram().statistics() is None
