"""The stream with its threads: live and replay, ends, callbacks, and counts that always add up.

No test sleeps: the clock is moved by hand, and a prediction lasts until its gate is opened.
"""

import threading
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from runtime.errors import InferenceError, InputError
from runtime.io.calibration import Calibration
from runtime.live.clock import MonotonicClock
from runtime.live.push_stream import PushStream
from runtime.predictor import Predictor

MS = 1_000_000


def image(value=0):
    rgb = np.full((32, 40, 3), value % 256, np.uint8)
    rgb[0, 0] = 255 - rgb[0, 0]
    return rgb


def depth(value=0):
    return np.full((32, 40), 1 + value % 50, np.float32)


def push_pair(stream, number):
    stream.push_image(image(number), number / 10)
    stream.push_depth(depth(number), number / 10)


def add_up(counts):
    """Check that every message is accounted for, and return the counts."""
    for of in (counts.images, counts.depths, counts):
        others = sum(sum(each.values()) for each in (of.dropped, of.unmatched, of.errors))
        assert of.pushed == of.answered + of.pending + others
        assert of.pending >= 0
    return counts


def test_answers_of_the_engine_come_back_with_both_stamps(model_file, make_frame):
    rgb, sparse_depth = make_frame()
    with Predictor(model_file(), threads=1) as predictor:
        expected = predictor.predict(rgb, sparse_depth)
        with PushStream(predictor, mode="live", deadline_ms=1e6, max_skew_ms=20) as stream:
            stream.push_image(rgb, 1.0)
            stream.push_depth(sparse_depth, 1_000_000_000)
            result = next(iter(stream))
            stream.close()
            assert list(stream) == []
    for head in predictor.heads:
        np.testing.assert_array_equal(
            getattr(result.prediction, head), getattr(expected, head), strict=True
        )
    np.testing.assert_array_equal(result.rgb, rgb)
    assert (result.sequence, result.image_stamp, result.depth_stamp) == (0, 1.0, 1_000_000_000)
    assert (result.skew_ms, result.deadline_met) == (0, True)
    assert result.age_ms == result.latency_ms > 0


def test_a_replay_answers_every_frame_in_order_from_two_threads(setup):
    stream = setup(mode="replay").stream
    n = 60

    def push_all(push, make):
        for number in range(n):
            push(make(number), number / 10)

    sensors = [
        threading.Thread(target=push_all, args=(stream.push_image, image)),
        threading.Thread(target=push_all, args=(stream.push_depth, depth)),
    ]

    def close_after_both():
        for sensor in sensors:
            sensor.join()
        stream.close()

    threads = [*sensors, threading.Thread(target=close_after_both)]
    for thread in threads:
        thread.start()
    results = list(stream)
    for thread in threads:
        thread.join()
    assert [result.image_stamp for result in results] == [number / 10 for number in range(n)]
    assert [result.depth_stamp for result in results] == [number / 10 for number in range(n)]
    assert [result.sequence for result in results] == list(range(n))
    for number, result in enumerate(results):
        assert (result.prediction.depth == depth(number) + 1).all()
    counts = add_up(stream.counts)
    assert counts.pushed == counts.answered == 2 * n


def push_all(made, frames):
    """Start a thread that pushes so many pairs. Returns it and the event of its end."""
    done = threading.Event()

    def push():
        for number in range(frames):
            push_pair(made.stream, number)
        done.set()
        made.clock.notify()

    pusher = threading.Thread(target=push)
    pusher.start()
    return pusher, done


def test_a_replay_makes_the_pusher_wait_until_there_is_room(setup):
    made = setup(mode="replay")
    made.predictor.gate.clear()
    pusher, done = push_all(made, 20)
    made.predictor.entered.acquire()
    assert made.clock.holds_up(
        pusher,
        made.stream._changed,
        still=lambda: len(made.stream._ready) == 2,
        ended=done.is_set,
    )
    assert made.stream.counts.images.pushed == 4, "one predicted, two ready, one held up"
    made.predictor.gate.set()
    assert [next(made.stream).image_stamp for _ in range(20)] == [n / 10 for n in range(20)]
    pusher.join(60)


@pytest.mark.parametrize("mode", ["live", "replay"])
def test_a_reader_is_woken_once_for_each_result(setup, mode):
    made = setup(mode=mode)
    waits = Counter()
    wait = made.clock.wait

    def count(changed, timeout_ns):
        waits[threading.current_thread().name] += 1
        wait(changed, timeout_ns)

    made.clock.wait = count
    reader = threading.Thread(target=lambda: next(made.stream), name="reader")
    reader.start()
    assert made.clock.holds_up(reader, made.stream._answered)
    push_pair(made.stream, 0)
    reader.join(60)
    assert waits["reader"] == 1


def test_a_live_push_never_waits_and_the_newest_complete_frame_wins(setup):
    made = setup(mode="live")
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    for number in range(1, 100):
        push_pair(made.stream, number)
    made.predictor.gate.set()
    made.stream.close()
    counts = add_up(made.stream.counts)
    assert counts.images.answered + counts.images.dropped["unread"] == 2
    assert counts.images.dropped["overtaken"] == 98
    assert counts.dropped["overtaken"] == 2 * 98
    (result,) = list(made.stream)
    assert result.image_stamp == 9.9, "the newest answer, of the newest frame"


def test_a_complete_frame_is_not_overtaken_by_one_without_depth(setup):
    made = setup(mode="live", max_wait_ms=50)
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    push_pair(made.stream, 1)
    made.stream.push_image(image(2), 0.2)
    made.clock.advance_ms(50)
    made.stream.push_image(image(3), 0.3)  # decides that 0.2 stays alone
    made.predictor.gate.set()
    made.predictor.entered.acquire()
    dropped = add_up(made.stream.counts).images.dropped
    assert dropped["incomplete"] == 1
    assert "overtaken" not in dropped
    made.stream.close()
    assert next(made.stream).image_stamp == 0.3


def test_an_image_without_depth_is_answered_from_the_camera_alone(setup):
    made = setup(mode="live", max_wait_ms=50)
    made.stream.push_image(image(), 5)
    made.clock.advance_ms(49)
    assert made.stream.counts.pending == 1
    made.clock.advance_ms(1)
    result = next(made.stream)
    assert (result.image_stamp, result.depth_stamp, result.skew_ms) == (5, None, None)
    assert result.prediction.degraded == ("no_depth",)
    assert result.latency_ms == 50
    counts = add_up(made.stream.counts)
    assert (counts.images.answered, counts.camera_only) == (1, 1)


def test_depth_without_an_image_is_dropped_and_counted(setup):
    made = setup(mode="live", max_wait_ms=50)
    made.stream.push_depth(depth(), 5)
    made.stream.push_depth(depth(), 6)
    made.stream.close()
    assert list(made.stream) == []
    counts = add_up(made.stream.counts)
    assert counts.depths.unmatched == {"no_image": 2}
    assert counts.pending == 0


def test_a_replay_waits_for_the_other_sensor_however_long_max_wait_is(setup):
    """Pairs follow from the stamps, not from the threads' turns."""
    made = setup(mode="replay", max_wait_ms=5)
    pushed = threading.Event()

    def push_images():
        for number in range(40):
            made.stream.push_image(image(number), number / 10)
        pushed.set()

    camera = threading.Thread(target=push_images)
    camera.start()
    assert made.clock.holds_up(camera, made.stream._changed, ended=pushed.is_set)
    for _ in range(199):
        made.clock.advance_ms(10)
        assert made.stream.counts.images.pushed == 17
    lidar = threading.Thread(
        target=lambda: [made.stream.push_depth(depth(n), n / 10) for n in range(40)]
    )
    lidar.start()
    closer = threading.Thread(target=lambda: (camera.join(), lidar.join(), made.stream.close()))
    closer.start()
    assert [(r.image_stamp, r.depth_stamp) for r in made.stream] == [
        (number / 10, number / 10) for number in range(40)
    ]
    closer.join(60)


@pytest.mark.parametrize("max_wait_ms", [0, 50])
def test_a_replay_of_one_sensor_alone_pauses_once_and_goes_on(setup, max_wait_ms):
    made = setup(mode="replay", max_wait_ms=max_wait_ms)
    pushed = threading.Event()

    def push_images():
        for number in range(40):
            made.stream.push_image(image(number), number / 10)
        pushed.set()
        made.clock.notify()

    camera = threading.Thread(target=push_images)
    camera.start()
    assert made.clock.holds_up(camera, made.stream._changed, ended=pushed.is_set)
    assert made.stream.counts.images.pushed == 17
    made.clock.advance_ms(2000)
    results = [next(made.stream) for _ in range(24)]
    camera.join(60)
    made.stream.close()
    results += made.stream
    assert [result.image_stamp for result in results] == [number / 10 for number in range(40)]
    assert add_up(made.stream.counts).camera_only == 40


def test_a_replay_of_depth_alone_is_unmatched_to_the_last(setup):
    made = setup(mode="replay", max_wait_ms=0)
    pushed = threading.Event()

    def push_depths():
        for number in range(17):
            made.stream.push_depth(depth(number), number / 10)
        pushed.set()
        made.clock.notify()

    lidar = threading.Thread(target=push_depths)
    lidar.start()
    made.clock.holds_up(lidar, made.stream._changed, ended=pushed.is_set)
    made.clock.advance_ms(2000)
    lidar.join(60)
    made.stream.close()
    assert add_up(made.stream.counts).unmatched == {"no_image": 17}


def test_latency_age_and_deadline(setup):
    now = iter([1.0, 2.5])
    made = setup(mode="live", deadline_ms=30, sensor_clock=lambda: next(now))
    made.predictor.takes_ms = 30
    push_pair(made.stream, 0)
    first = next(made.stream)
    made.predictor.takes_ms = 30.001
    push_pair(made.stream, 10)
    second = next(made.stream)
    assert (first.latency_ms, first.age_ms, first.deadline_met) == (30, 1000, True)
    assert (second.latency_ms, second.age_ms, second.deadline_met) == (30.001, 1500, False)


def test_the_skew_of_a_frame_has_a_sign_and_that_of_the_statistics_none(setup):
    made = setup(mode="replay")
    for image_ms, depth_ms in ((0, 20), (100, 60)):
        made.stream.push_image(image(), image_ms * MS)
        made.stream.push_depth(depth(), depth_ms * MS)
    made.stream.close()
    assert [result.skew_ms for result in made.stream] == [20, -40]
    skew = made.stream.statistics.stages["skew"]
    assert (skew.n, skew.mean_ms, skew.max_ms) == (2, 30, 40)


def test_in_a_replay_latency_begins_with_the_turn_and_there_is_no_age(setup):
    made = setup(mode="replay")
    made.predictor.takes_ms = 30
    for number in range(3):
        push_pair(made.stream, number)
    made.stream.close()
    assert [(r.latency_ms, r.age_ms, r.deadline_met) for r in made.stream] == [(30, None, None)] * 3


def test_pushed_arrays_may_be_reused_afterwards(setup):
    made = setup(mode="replay")
    made.predictor.gate.clear()
    rgb, sparse_depth = image(3), depth(3)
    made.stream.push_image(rgb, 0)
    made.stream.push_depth(sparse_depth, 0)
    rgb[:], sparse_depth[:] = 0, 0
    made.predictor.gate.set()
    result = next(made.stream)
    assert (result.rgb == image(3)).all()
    assert (result.prediction.depth == depth(3) + 1).all()


# --- errors ------------------------------------------------------------------------------------


def test_invalid_messages_are_refused_and_counted(setup):
    stream = setup().stream
    with pytest.raises(InputError, match="rgb must be uint8"):
        stream.push_image(image().astype(np.float32), 0)
    with pytest.raises(InputError, match="sparse_depth must be float32"):
        stream.push_depth(depth().astype(np.float64), 0)
    with pytest.raises(InputError, match="sparse_depth must have the shape"):
        stream.push_depth(np.zeros((3, 4, 5), np.float32), 0)
    with pytest.raises(InputError, match="stamp must be"):
        stream.push_image(image(), None)
    counts = add_up(stream.counts)
    assert counts.images.errors == {"bad_message": 1, "bad_stamp": 1}
    assert counts.depths.errors == {"bad_message": 2}


def test_frames_that_do_not_fit_and_a_failing_session_are_errors_and_the_stream_goes_on(setup):
    reported, heard = [], threading.Semaphore(0)

    def hear(error):
        reported.append(type(error))
        heard.release()

    made = setup(mode="replay", on_error=hear)
    made.stream.push_image(image(), 0)
    made.stream.push_depth(np.ones((32, 41), np.float32), 0)
    assert heard.acquire(timeout=60)
    made.predictor.fail_with = InferenceError("the device was lost")
    push_pair(made.stream, 1)
    assert heard.acquire(timeout=60)
    made.predictor.fail_with = None
    push_pair(made.stream, 2)
    made.stream.close()
    assert [result.image_stamp for result in made.stream] == [0.2]
    assert reported == [InputError, InferenceError]
    counts = add_up(made.stream.counts)
    assert counts.images.errors == {"input_error": 1, "inference_error": 1}
    assert counts.depths.errors == {"input_error": 1, "inference_error": 1}


@pytest.mark.parametrize("options", [
    {"mode": "fast"}, {"mode": None}, {"deadline_ms": 0}, {"deadline_ms": "1"},
    {"deadline_ms": True}, {"max_skew_ms": -1}, {"max_skew_ms": float("nan")},
    {"max_wait_ms": float("inf")}, {"calibration": 5}, {"watchdog": 5}, {"on_result": 5},
    {"on_error": "print"}, {"on_state": 0}, {"sensor_clock": 1.5}, {"consistency": "x"},
])  # fmt: skip
def test_options_out_of_range(setup, options):
    with pytest.raises(InputError, match=next(iter(options))):
        setup(**options)


# --- the end -----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["live", "replay"])
def test_close_answers_what_waits_and_may_be_called_again_and_from_any_thread(setup, mode):
    made = setup(mode=mode)
    made.stream.push_image(image(), 1.0)
    made.stream.push_depth(depth(), 2.0)
    made.stream.push_image(image(), 3.0)
    closers = [threading.Thread(target=made.stream.close) for _ in range(4)]
    for thread in closers:
        thread.start()
    for thread in closers:
        thread.join(60)
        assert not thread.is_alive()
    made.stream.close()
    answered = [result.image_stamp for result in made.stream]
    assert answered == ([3.0] if mode == "live" else [1.0, 3.0])
    push_pair(made.stream, 40)
    counts = add_up(made.stream.counts)
    assert counts.pending == 0
    assert counts.dropped["closed"] == 2


def test_close_releases_pushes_and_readers_that_wait(setup):
    made = setup(mode="replay")
    made.predictor.gate.clear()
    done = threading.Event()

    def push_for_ever():
        for number in range(1000):
            push_pair(made.stream, number)
        done.set()

    pusher = threading.Thread(target=push_for_ever)
    pusher.start()
    made.predictor.entered.acquire()
    closer = threading.Thread(target=made.stream.close)
    closer.start()
    assert done.wait(60), "pushing to a closed stream does not wait"
    made.predictor.gate.set()
    closer.join(60)
    pusher.join(60)
    results = list(made.stream)
    assert [result.sequence for result in results] == list(range(len(results)))
    counts = add_up(made.stream.counts)
    assert (counts.pushed, counts.pending) == (2000, 0)
    assert counts.images.answered == len(results) >= 1


def test_ctrl_c_in_a_push_that_waits_loses_no_message(setup):
    made = setup(mode="replay")
    made.predictor.gate.clear()
    wait, here = made.clock.wait, threading.get_ident()

    def interrupted(changed, timeout_ns):
        if threading.get_ident() == here:
            raise KeyboardInterrupt
        wait(changed, timeout_ns)

    def push_many():
        for number in range(30):
            push_pair(made.stream, number)

    made.clock.wait = interrupted
    with pytest.raises(KeyboardInterrupt):
        push_many()
    made.clock.wait = wait
    made.predictor.gate.set()
    made.stream.close()
    counts = add_up(made.stream.counts)
    assert (counts.pending, counts.dropped) == (0, {"interrupted": 1})
    assert counts.images.answered == len(list(made.stream)) >= 1


def test_a_replay_that_nobody_reads_holds_a_bounded_number_of_answers_and_can_be_closed(setup):
    made = setup(mode="replay")
    pusher, done = push_all(made, 200)
    assert made.clock.holds_up(
        pusher,
        made.stream._changed,
        still=lambda: len(made.stream._results) == 8 and len(made.stream._ready) == 2,
        ended=done.is_set,
    )
    assert made.stream.counts.images.pushed == 8 + 2 + 1
    made.stream.close()
    pusher.join(60)
    assert [result.sequence for result in made.stream] == list(range(10))
    assert add_up(made.stream.counts).pending == 0


def test_on_result_is_called_in_order_and_may_close_the_stream(setup):
    seen = []

    def see(result):
        seen.append(result.sequence)
        if result.sequence == 2:
            made.stream.close()

    made = setup(mode="replay", on_result=see)
    for number in range(30):
        push_pair(made.stream, number)
    made.stream.close()
    assert seen[:3] == [0, 1, 2]
    assert add_up(made.stream.counts).pending == 0
    with pytest.raises(InputError, match="on_result"):
        iter(made.stream)


@pytest.mark.parametrize("mode", ["live", "replay"])
def test_an_unexpected_error_ends_the_stream_and_reaches_on_error_the_pushes_and_close(setup, mode):
    reported, heard = [], threading.Event()

    def hear(error):
        reported.append(error)
        heard.set()

    made = setup(mode=mode, on_error=hear)
    failure = made.predictor.fail_with = ZeroDivisionError("a bug")
    push_pair(made.stream, 0)
    assert heard.wait(60)
    for _ in range(2):
        with pytest.raises(InferenceError, match=r"a bug.*make a new one") as raised:
            made.stream.push_image(image(), 1)
        assert raised.value.__cause__ is failure
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    made.stream.close()
    assert reported == [failure]
    assert add_up(made.stream.counts).pending == 0


def test_an_error_of_on_error_itself_comes_out_at_close(setup):
    made = setup(mode="replay", on_error=lambda error: 1 / 0)
    made.predictor.fail_with = InferenceError("the device was lost")
    push_pair(made.stream, 0)
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    assert add_up(made.stream.counts).errors == {"inference_error": 2}


@pytest.mark.parametrize("part", ["advance", "due_ns"])
def test_an_error_of_the_worker_outside_of_a_frame_ends_the_stream(setup, part):
    made = setup(mode="live")
    setattr(made.stream._synchronizer, part, lambda *args: 1 / 0)
    made.stream.push_image(image(), 0)
    with pytest.raises(ZeroDivisionError):
        next(made.stream)
    assert add_up(made.stream.counts).pending == 0


def push_until_it_raises(stream):
    def push():
        for number in range(10_000):
            push_pair(stream, number)

    with pytest.raises(InferenceError, match="ZeroDivisionError"):
        push()


def test_an_error_of_the_callback_ends_the_stream_and_comes_out_at_close(setup):
    made = setup(mode="replay", on_result=lambda result: 1 / 0)
    push_until_it_raises(made.stream)
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    made.stream.close()
    assert add_up(made.stream.counts).pending == 0


def test_an_error_of_the_callback_releases_pushes_that_wait(setup):
    made = setup(mode="replay", on_result=lambda result: 1 / 0)
    made.predictor.gate.clear()
    raised = []

    def push():
        try:
            push_until_it_raises(made.stream)
        finally:
            raised.append(True)

    pusher = threading.Thread(target=push)
    pusher.start()
    assert made.clock.holds_up(pusher, made.stream._changed, ended=lambda: bool(raised))
    made.predictor.gate.set()
    pusher.join(20)
    assert raised
    assert not pusher.is_alive()
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    assert add_up(made.stream.counts).pending == 0


def test_an_error_of_the_sensors_clock_ends_the_stream_and_its_frame_is_counted(setup):
    made = setup(mode="replay", sensor_clock=lambda: 1 / 0)
    push_until_it_raises(made.stream)
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    counts = add_up(made.stream.counts)
    assert (counts.pending, counts.answered) == (0, 0)
    assert counts.errors == {"inference_error": 2}


def test_an_invalid_time_of_the_sensors_clock_is_an_error_of_each_frame(setup):
    reported = []
    made = setup(mode="replay", sensor_clock=lambda: float("nan"), on_error=reported.append)
    for number in range(3):
        push_pair(made.stream, number)
    made.stream.close()
    assert [str(error)[:13] for error in reported] == ["stamp must be"] * 3
    assert add_up(made.stream.counts).errors == {"input_error": 6}


def test_an_error_of_the_block_is_not_hidden_by_one_of_the_callback(setup):
    def fail(result):
        raise ZeroDivisionError

    def work():
        with setup(mode="replay", on_result=fail).stream as stream:
            push_pair(stream, 0)
            raise KeyError

    with pytest.raises(KeyError):
        work()


# --- any sequence, with threads ----------------------------------------------------------------


def arrays(*good):
    """Arrays of any shape and type, other objects, and valid arrays."""
    shapes = st.one_of(
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=40),
        st.sampled_from([(32, 40), (32, 40, 3), (1, 1, 3), (0, 3), (5, 3), (5, 4), (5, 2), (8, 8)]),
    )
    types = st.one_of(
        st.sampled_from([np.uint8, np.uint16, np.int16, np.float16, np.float32, np.float64]),
        st.sampled_from([bool, object, complex, "U3", "M8[ns]", [("x", "f4")], ">f4"]),
    )
    return st.one_of(
        st.builds(np.zeros, shapes, types),
        st.builds(np.ma.zeros, shapes, types),
        st.sampled_from([None, "picture", b"1", 3.0, [], [[[1, 2, 3]]], np.float32(1), *good]),
    )


def flawed_depth(value):
    return np.full((32, 40), value, np.float32)


images = arrays(image(1), image(2), np.zeros((32, 40, 3), np.uint8), image(3)[:, ::-1])
depths = arrays(depth(1), depth(2), depth().T, *map(flawed_depth, (np.nan, -np.inf, -1, 1e30, 0)))
scans = arrays(*(np.full((9, 4), value, np.float32) for value in (1, np.nan, np.inf, 1e30, -1)))
stamps = st.one_of(
    st.sampled_from([None, "now", True, 2**70, 1j, np.zeros(2), np.float32(0.5), np.uint64(7)]),
    st.floats(),
    st.integers(-(2**64), 2**64),
    st.floats(0, 3),
    st.floats(0, 3),
)
messages_of_all_sensors = st.lists(
    st.one_of(
        st.tuples(st.just("push_image"), images, stamps),
        st.tuples(st.just("push_depth"), depths, stamps),
        st.tuples(st.just("push_points"), scans, stamps),
    ),
    min_size=100,
    max_size=150,
)


def is_stamp(stamp):
    """Whether it fits in 64 bits of nanoseconds, computed independently of the code."""
    if isinstance(stamp, float | np.floating):
        return bool(abs(stamp) * 1e9 < 2**63)
    return type(stamp) in (int, np.uint64) and -(2**63) <= stamp < 2**63


def is_message(method, data):
    if type(data) is not np.ndarray:
        return False
    if method == "push_image":
        return data.dtype == "=u1" and data.shape[2:] == (3,) and min(data.shape[:2]) >= 32
    return data.dtype == "=f4" and data.ndim == 2 and (method == "push_depth" or data.shape[1] > 2)


class FastClock(MonotonicClock):
    """A thousand seconds in one, so that no replay pauses for long."""

    def now_ns(self):
        return 1000 * super().now_ns()

    def wait(self, changed, timeout_ns):
        super().wait(changed, None if timeout_ns is None else timeout_ns // 1000)


def test_10_000_bad_messages_are_refused_or_flagged_and_accounted_for(checked_predictor):
    bad = Counter()

    @settings(
        # Always the same messages; shrinking lists of so many takes minutes.
        max_examples=25,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
    )
    @given(messages=messages_of_all_sensors)
    def push_them(messages):
        for live, threads in ((True, 1), (True, 3), (False, 1), (False, 2)):
            push_to_one(messages, live, threads)

    def push_to_one(messages, live, threads):
        wrong, answers = [], []
        stream = PushStream(
            checked_predictor(),
            mode="live" if live else "replay",
            max_wait_ms=0,
            calibration=Calibration(np.eye(3), np.eye(4)),
            on_result=answers.append,
            clock=FastClock(),
        )

        def push(part):
            for method, data, stamp in part:
                expected = None
                if not is_message(method, data):
                    expected = "must"
                if not is_stamp(stamp):
                    expected = "stamp must"
                try:
                    getattr(stream, method)(data, stamp)
                    message = None
                except InputError as error:
                    message = str(error)
                if (message is None) != (expected is None) or (message and expected not in message):
                    wrong.append((method, data, stamp, message))

        pushers = [
            threading.Thread(target=push, args=(messages[k::threads],)) for k in range(threads)
        ]
        for pusher in pushers:
            pusher.start()
        for pusher in pushers:
            pusher.join(60)
            assert not pusher.is_alive()
        stream.close()
        assert wrong == []
        counts = add_up(stream.counts)
        assert counts.pushed == len(messages)
        assert counts.pending == 0
        assert counts.images.answered == len(answers)
        no_stamp = sum(not is_stamp(stamp) for _, _, stamp in messages)
        refused = sum(
            not (is_stamp(stamp) and is_message(method, data)) for method, data, stamp in messages
        )
        assert counts.errors.get("bad_stamp", 0) == no_stamp
        assert counts.errors.get("bad_message", 0) == refused - no_stamp
        bad["refused"] += refused
        for result in answers:
            prediction = result.prediction
            assert np.isfinite(prediction.depth).all()
            if not result.rgb.any():
                assert "image_black" in result.health
                bad["black"] += 1
            if not prediction.depth_returns:
                assert "no_depth" in prediction.degraded

    push_them()
    assert bad["refused"] >= 10_000
    assert bad["black"] > 0, "some of the bad ones come through and are flagged"


# --- statistics and the watchdog ---------------------------------------------------------------


def test_statistics_hold_every_answer(setup):
    made = setup(mode="live", deadline_ms=30)
    for number, takes_ms in enumerate([10, 40, 50, 20]):
        made.predictor.takes_ms = takes_ms
        made.stream.push_image(image(), number / 10)
        made.stream.push_depth(depth(), number / 10)
        next(made.stream)
    statistics = made.stream.statistics
    stages = statistics.stages
    assert (stages["latency"].n, stages["latency"].max_ms, stages["latency"].mean_ms) == (4, 50, 30)
    assert stages["age"] == stages["latency"]
    assert (stages["skew"].n, stages["skew"].max_ms) == (4, 0)
    assert (stages["jitter"].n, stages["predict"].n) == (3, 4)
    assert (statistics.missed.count, statistics.missed.longest_run) == (2, 2)


def test_the_watchdog_reports_changes_and_its_present_state(setup):
    reported, heard = [], threading.Semaphore(0)

    def hear(state):
        reported.append((str(state.level), state.reasons))
        heard.release()

    made = setup(mode="live", deadline_ms=30, on_state=hear)
    assert str(made.stream.state.level) == "n/a"
    push_pair(made.stream, 0)
    next(made.stream)
    made.predictor.takes_ms = 31
    push_pair(made.stream, 1)
    next(made.stream)
    for _ in range(2):
        assert heard.acquire(timeout=60)
    made.clock.advance_ms(500)
    assert heard.acquire(timeout=60)
    made.predictor.gate.clear()
    push_pair(made.stream, 2)
    made.clock.advance_ms(2000)
    assert str(made.stream.state.level) == "ERROR", "while the worker hangs"
    made.predictor.gate.set()
    made.predictor.takes_ms = 0
    made.stream.close()
    assert reported[:3] == [("OK", ()), ("WARN", ("late",)), ("WARN", ("late", "silence_ms"))]


def test_errors_reach_the_watchdog(setup):
    reported, heard = [], threading.Semaphore(0)

    def hear(state):
        reported.append(state.reasons)
        heard.release()

    made = setup(mode="replay", on_state=hear)
    made.predictor.fail_with = InferenceError("the device was lost")
    push_pair(made.stream, 0)
    while ("failed",) not in reported:
        assert heard.acquire(timeout=60)


def test_stamps_that_jump_back_are_no_jitter(setup):
    made = setup(mode="live")
    for number in (100, 0):
        push_pair(made.stream, number)
        next(made.stream)
    assert made.stream.counts.jumps_back == 1
    assert made.stream.statistics.stages["jitter"] is None
    push_pair(made.stream, 1)
    next(made.stream)
    assert made.stream.statistics.stages["jitter"].n == 1


# --- health and calibration --------------------------------------------------------------------


def test_a_frozen_camera_and_a_lost_sector_are_flagged(setup):
    made = setup(mode="replay", on_state=lambda state: None)
    whole = np.random.default_rng(0).uniform(1, 50, (32, 40)).astype(np.float32)
    sector = whole.copy()
    sector[:, :10] = 0
    for number in range(8):
        made.stream.push_image(image(min(number, 6)), number / 10)
        made.stream.push_depth(whole if number < 6 else sector, number / 10)
        if number < 7:
            next(made.stream)
    assert next(made.stream).health == ("image_frozen", "lidar_sector_lost")
    assert made.stream.state.reasons == ("degraded",)


def test_points_are_projected_and_the_focal_length_is_the_cameras(setup):
    intrinsics = np.array([[30.0, 0, 20], [0, 30, 16], [0, 0, 1]])
    made = setup(mode="replay", calibration=Calibration(intrinsics, np.eye(4), (32, 40)))
    points = np.array([[0, 0, 10, 0.5], [2, 0, 10, 0.5], [0, 0, -3, 0.5]], np.float32)
    made.stream.push_image(image(), 0)
    made.stream.push_points(points, 0)
    points[:] = 1
    result = next(made.stream)
    expected = np.ones((32, 40), np.float32)
    expected[16, [20, 26]] = 11
    np.testing.assert_array_equal(result.prediction.depth, expected)
    assert made.predictor.focal_lengths_px == [30]


def test_bad_points_are_refused_and_counted(setup):
    calibrated = setup(calibration=Calibration(np.eye(3), np.eye(4))).stream
    for points in (None, np.zeros((3, 2), np.float32), np.zeros((3, 3)), np.float32(1)):
        with pytest.raises(InputError, match="points must"):
            calibrated.push_points(points, 0)
    assert add_up(calibrated.counts).depths.errors == {"bad_message": 4}
    with pytest.raises(InputError, match="calibration="):
        setup().stream.push_points(np.zeros((3, 3), np.float32), 0)


def test_returns_are_held_out_with_the_option_consistency(setup):
    made = setup(mode="replay", consistency=0.5)
    plain = setup(mode="replay")
    for stream in (made.stream, plain.stream):
        push_pair(stream, 0)
        stream.push_image(image(1), 0.2)
        stream.close()
    result, camera_only = made.stream
    assert 0.4 < result.prediction.depth_returns / (32 * 40) < 0.6
    assert result.consistency.holdout_error == 0, "0 + 1 m where 1 m was held out"
    assert result.consistency.scale_error == 0
    assert camera_only.consistency is None
    assert next(plain.stream).prediction.depth_returns == 32 * 40
    assert next(plain.stream).consistency is None


def test_depth_that_contradicts_the_image_is_reported_with_the_option_consistency(
    setup, monkeypatch
):
    row, column = np.mgrid[:32, :40]
    seen = ((40 - row + column / 2) / 10).astype(np.float32)
    for options, degraded in (({"consistency": 0.05}, ("implausible_depth",)), ({}, ())):
        made = setup(mode="replay", **options)

        def see(rgb, sparse_depth, predict=made.predictor.predict, **others):
            answer = predict(rgb, sparse_depth, **others)
            return answer if sparse_depth.any() else replace(answer, heads={"depth": seen})

        monkeypatch.setattr(made.predictor, "predict", see)
        for stamp in (0.0, 0.1):
            made.stream.push_image(image(), stamp)
            made.stream.push_depth(10 * seen, stamp)
        made.stream.close()
        assert [result.prediction.degraded for result in made.stream] == [degraded] * 2
