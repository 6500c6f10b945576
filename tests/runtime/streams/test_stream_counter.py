import json

import pytest

from runtime.base.errors import InferenceError, InputError
from runtime.streams.matching import Discarded, Pair
from runtime.streams.messages import Depth, Image, Outcome, Sensor
from runtime.streams.statistics import MissedDeadlines
from runtime.streams.stream_counter import (
    MessageCounts,
    StreamCounter,
    WatchdogLevel,
    WatchdogLimits,
)
from stream_messages import result

MS = 1_000_000
IMAGE, SCAN = Image(None, stamp_ns=10**9), Depth(None, stamp_ns=9 * 10**8)
BOTH, ALONE, REUSED = Pair(IMAGE, SCAN), Pair(IMAGE), Pair(IMAGE, SCAN, reused=True)


def test_each_message_is_counted_once_with_its_outcome():
    counter = StreamCounter()
    for sensor in (*Sensor, *Sensor, *Sensor, Sensor.IMAGE, Sensor.IMAGE):
        counter.push(sensor)
    for pair in (BOTH, ALONE, REUSED):
        counter.record_answer(pair, result())
    counter.record_pair(BOTH, Outcome.OVERTAKEN)
    gone = [Discarded(SCAN, Outcome.NO_IMAGE)]
    counter.record_discarded(gone, jumped_back=True)
    counts = counter.counts
    assert counts.images == MessageCounts(pushed=5, answered=3, dropped={"overtaken": 1})
    assert counts.depths == MessageCounts(
        pushed=3, answered=1, dropped={"overtaken": 1}, unmatched={"no_image": 1}
    )
    assert (counts.pushed, counts.answered, counts.pending) == (8, 4, 1)
    assert (counts.dropped, counts.unmatched) == ({"overtaken": 2}, {"no_image": 1})
    assert (counts.camera_only, counts.reused) == (1, 1)
    assert counts.jumps_back == 1
    assert {type(reason) for reason in counts.dropped} == {str}, "printed without the enum's name"


def test_an_answer_that_was_not_fetched_counts_as_dropped():
    counter = StreamCounter()
    for pair in (BOTH, ALONE, REUSED):
        counter.record_answer(pair, result())
        counter.record_unread(pair)
    counts = counter.counts
    assert (counts.answered, counts.camera_only, counts.reused) == (0, 0, 0)
    assert (counts.images.dropped, counts.depths.dropped) == ({"unread": 3}, {"unread": 1})


def test_every_outcome_is_of_one_kind():
    for outcome in Outcome:
        counter = StreamCounter()
        counter.push(Sensor.DEPTH, outcome)
        assert counter.counts.pending == 0, outcome


def test_misses_and_their_longest_run():
    counter = StreamCounter(50.0)
    for number, met in enumerate([True, False, False, True, False]):
        counter.record_answer(BOTH, result(number, deadline_met=met))
    statistics = counter.statistics
    assert statistics.missed == MissedDeadlines(count=3, longest_run=2)
    assert (statistics.stages["latency"].n, statistics.stages["jitter"]) == (5, None)
    deadline = {"deadline_ms": 50.0, "count": 3, "longest_run": 2}
    assert json.loads(json.dumps(statistics.to_dict()))["deadline"] == deadline
    *lines, last = statistics.table().splitlines()
    assert last == "missed deadlines of 50 ms: 3, longest run 2"
    stages = [line.split()[0] for line in lines]
    assert stages[5:10] == ["latency", "age", "jitter", "skew", "depth_age"]


# --- the state ----------------------------------------------------------------------------------


def answered(counter, at_ms=0, *, late=False, **wrong):
    counter.record_answer(ALONE, result(deadline_met=not late, **wrong), at_ms * MS)


def levels(counter, at_ms=0):
    state = counter.state(at_ms * MS)
    return state.level.value, state.reasons


def test_not_available_before_the_first_message():
    counter = StreamCounter()
    assert levels(counter, 10**6) == ("n/a", ())
    counter.record_accepted(Sensor.POSE, 0)
    assert levels(counter) == ("OK", ())


@pytest.mark.parametrize(("wrong", "limits"), [
    ({"late": True}, {"late": (2, 4)}), ({"degraded": ("no_depth",)}, {"degraded": (2, 4)}),
    ({"health": ("image_frozen",)}, {"degraded": (2, 4)}),
    ({"degraded": ("depth_reused",)}, {"reused": (2, 4)}), ({"valid": False}, {"failed": (2, 4)}),
])  # fmt: skip
def test_runs_warn_then_are_an_error_and_end(wrong, limits):
    counter = StreamCounter(limits=WatchdogLimits(**limits))
    (reason,) = limits
    expected = ["OK", "WARN", "WARN", "ERROR", "ERROR"]
    for level in expected:
        answered(counter, **wrong)
        assert levels(counter) == (level, () if level == "OK" else (reason,))
    answered(counter)
    assert levels(counter) == ("OK", ())


def test_frames_that_were_errors_count_as_failed():
    counter = StreamCounter(limits=WatchdogLimits(failed=(1, 2)))
    counter.record_accepted(Sensor.POSE, 0)
    for level in ("WARN", "ERROR"):
        counter.record_failed(ALONE, InferenceError())
        assert levels(counter) == (level, ("failed",))


def test_silence_is_reported_by_the_clock_and_ends_with_a_result():
    never = (None, None)
    limits = WatchdogLimits(silence_ms=(500, 2000), camera_silent=never, lidar_silent=never)
    counter = StreamCounter(limits=limits)
    counter.record_accepted(Sensor.POSE, 0)
    counter.record_accepted(Sensor.IMAGE, 400 * MS)  # only the first message counts
    assert counter.due_ns(0) == 500 * MS
    assert levels(counter, 499) == ("OK", ())
    assert levels(counter, 500) == ("WARN", ("silence_ms",))
    assert counter.due_ns(500 * MS) == 2000 * MS
    assert levels(counter, 2000) == ("ERROR", ("silence_ms",))
    assert counter.due_ns(2000 * MS) is None
    answered(counter, 2100)
    assert levels(counter, 2100) == ("OK", ())


def test_the_sensor_that_is_silent_is_named():
    counter = StreamCounter(limits=WatchdogLimits(silence_ms=(None, None)))
    counter.record_accepted(Sensor.IMAGE, 0)
    assert levels(counter, 499) == ("OK", ())
    assert levels(counter, 500) == ("WARN", ("camera_silent",)), "a LiDAR was never heard of"
    counter.record_accepted(Sensor.DEPTH, 600 * MS)
    counter.record_accepted(Sensor.IMAGE, 900 * MS)
    assert counter.due_ns(900 * MS) == 1100 * MS
    assert levels(counter, 1100) == ("WARN", ("lidar_silent",))
    assert levels(counter, 1400) == ("WARN", ("camera_silent", "lidar_silent"))
    assert levels(counter, 2900) == ("ERROR", ("camera_silent", "lidar_silent"))
    counter.record_accepted(Sensor.IMAGE, 2900 * MS)
    assert levels(counter, 3000) == ("WARN", ("lidar_silent",)), "no error: the camera answers"
    counter.record_accepted(Sensor.DEPTH, 3000 * MS)
    assert levels(counter, 3000) == ("OK", ())


def test_a_replay_is_never_silent():
    """It has no clock: the time since its answers, by that of a live stream, would be hours."""
    counter = StreamCounter()
    assert levels(counter, 10**9) == ("n/a", ())
    counter.record_answer(ALONE, result(0))
    assert levels(counter, 10**9) == ("OK", ())
    assert counter.due_ns(0) is None
    counter.record_answer(ALONE, result(1, degraded=("no_depth",)))
    assert levels(counter, 10**9) == ("WARN", ("degraded",))


def test_the_worst_counts_and_none_is_never():
    counter = StreamCounter(limits=WatchdogLimits(late=(1, 1), degraded=(1, None)))
    for _ in range(100):
        answered(counter, degraded=("no_depth",))
    assert counter.state(0).level is WatchdogLevel.WARN
    answered(counter, late=True, degraded=("no_depth",))
    assert levels(counter) == ("ERROR", ("late", "degraded"))


@pytest.mark.parametrize("pair", [None, (1,), (0, 2), (1, True), ("1", 2), [1, 2], (-1, None)])
def test_invalid_limits(pair):
    with pytest.raises(InputError, match="late must be a pair"):
        WatchdogLimits(late=pair)
