"""The stream is closed, interrupted or ended by an error, or goes on after one."""

import threading

import numpy as np
import pytest

from runtime.errors import InferenceError, InputError
from stream_messages import add_up, depth, image, push_all, push_pair


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
