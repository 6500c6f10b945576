import json

import numpy as np

from runtime.live.frame_result import FrameResult
from runtime.live.stream_statistics import StatisticsRecorder
from runtime.prediction import Latency, Prediction
from runtime.sync.latency import MissedDeadlines


def result(number, *, deadline_met=None):
    return FrameResult(
        sequence=number,
        rgb=np.zeros((32, 40, 3), np.uint8),
        prediction=Prediction({}, (32, 40), (32, 40), Latency(0, 0, 0, 0)),
        consistency=None,
        image_stamp=number,
        latency_ms=40.0,
        age_ms=40.0,
        deadline_met=deadline_met,
    )


def test_misses_and_their_longest_run():
    recorder = StatisticsRecorder(50.0)
    for number, met in enumerate([True, False, False, True, False]):
        recorder.record(result(number, deadline_met=met))
    statistics = recorder.statistics()
    assert statistics.missed == MissedDeadlines(count=3, longest_run=2)
    assert statistics.stages["latency"].n == 5
    assert statistics.stages["jitter"] is None
    assert json.loads(json.dumps(statistics.to_dict()))["deadline"] == {
        "deadline_ms": 50.0,
        "count": 3,
        "longest_run": 2,
    }
    lines = statistics.table().splitlines()
    assert lines[-1] == "missed deadlines of 50 ms: 3, longest run 2"
    names = [line.split()[0] for line in lines]
    assert names[5:10] == ["latency", "age", "jitter", "skew", "depth_age"]


def test_without_a_deadline_there_are_no_misses():
    recorder = StatisticsRecorder(None)
    recorder.record(result(0))
    assert recorder.statistics().missed is None
    assert recorder.statistics().to_dict()["deadline"] is None
