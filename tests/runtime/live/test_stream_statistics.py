import json
from types import SimpleNamespace

import pytest

from runtime.live.stream_statistics import StatisticsRecorder
from runtime.prediction import Latency
from runtime.sync.latency import MissedDeadlines

MS = 1_000_000


def record(recorder, image_ms, answered_ms, *, met=None, latency=1.0):
    result = SimpleNamespace(
        prediction=SimpleNamespace(latency=Latency(0, 0, 0, 0)),
        latency_ms=latency,
        age_ms=None,
        skew_ms=None,
        depth_age_ms=None,
        depth_reused=False,
        deadline_met=met,
    )
    recorder.record(result, transit_ns=(answered_ms - image_ms) * MS)


def test_jitter_is_the_difference_of_successive_transit_times():
    recorder = StatisticsRecorder(None)
    for image_ms, answered_ms in [(0, 1000), (100, 1100), (200, 1230), (300, 1300)]:
        record(recorder, image_ms, answered_ms)
    jitter = recorder.statistics().stages["jitter"]
    assert (jitter.n, jitter.max_ms) == (3, 30)
    assert jitter.mean_ms == pytest.approx((0 + 30 + 30) / 3)


def test_a_jump_of_the_stamps_is_no_jitter():
    recorder = StatisticsRecorder(None)
    record(recorder, 50_000, 1000)
    recorder.reset_jitter()
    record(recorder, 0, 1100)
    assert recorder.statistics().stages["jitter"] is None


def test_misses_and_their_longest_run():
    recorder = StatisticsRecorder(50.0)
    for number, met in enumerate([True, False, False, True, False]):
        record(recorder, number, number, met=met, latency=40.0)
    statistics = recorder.statistics()
    assert statistics.missed == MissedDeadlines(count=3, longest_run=2)
    assert statistics.stages["latency"].n == 5
    assert statistics.stages["age"] is None
    assert json.loads(json.dumps(statistics.to_dict()))["deadline"] == {
        "deadline_ms": 50.0,
        "count": 3,
        "longest_run": 2,
    }
    lines = statistics.table().splitlines()
    assert lines[-1] == "missed deadlines of 50 ms: 3, longest run 2"
    names = [line.split()[0] for line in lines]
    assert names[5:10] == ["latency", "age", "skew", "depth", "jitter"]


def test_without_a_deadline_there_are_no_misses():
    recorder = StatisticsRecorder(None)
    record(recorder, 0, 0, latency=1.0)
    assert recorder.statistics().missed is None
    assert recorder.statistics().to_dict()["deadline"] is None
