import pytest

from runtime.base.errors import InferenceError, InputError
from runtime.streams.matching import Pair
from runtime.streams.messages import Image, Sensor
from runtime.streams.stream_counter import StreamCounter, WatchdogLevel, WatchdogLimits
from stream_messages import result

MS = 1_000_000
FRAME = Pair(Image(None, stamp_ns=10**9))


def answered(counter, at_ms=0, *, late=False, **wrong):
    counter.record_answer(FRAME, result(deadline_met=not late, **wrong), at_ms * MS)


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
        counter.record_failed(FRAME, InferenceError())
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
    counter.record_answer(FRAME, result(0))
    assert levels(counter, 10**9) == ("OK", ())
    assert counter.due_ns(0) is None
    counter.record_answer(FRAME, result(1, degraded=("no_depth",)))
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
