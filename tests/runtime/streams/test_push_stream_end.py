"""The stream is closed, interrupted or ended by an error, or goes on after one."""

import gc
import subprocess
import sys
import threading
import weakref

import numpy as np
import pytest

from runtime.base.errors import InferenceError, InputError
from runtime.streams.push_stream import PushStream
from stream_messages import add_up, depth, image, push_pair


def test_frames_that_do_not_fit_and_a_failing_session_are_errors_and_the_stream_goes_on(setup):
    reported, heard = [], threading.Semaphore(0)

    def hear(error):
        reported.append(type(error))
        heard.release()

    made = setup(on_error=hear)
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


def test_close_answers_what_waits_and_may_be_called_again_and_from_any_thread(setup):
    made = setup()
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
    assert [result.image_stamp for result in made.stream] == [3.0]
    push_pair(made.stream, 40)
    counts = add_up(made.stream.counts)
    assert counts.pending == 0
    assert counts.dropped["closed"] == 2


def test_close_releases_a_reader_that_waits(setup):
    stream, results = setup().stream, []
    reader = threading.Thread(target=lambda: results.extend(stream))
    reader.start()
    stream.close()
    reader.join(60)
    assert (reader.is_alive(), results) == (False, [])


def test_on_result_is_called_in_order_and_may_close_the_stream(setup):
    seen, heard = [], threading.Semaphore(0)

    def see(result):
        seen.append(result.sequence)
        if result.sequence == 2:
            made.stream.close()
        heard.release()

    made = setup(on_result=see)
    for number in range(3):
        push_pair(made.stream, number)
        assert heard.acquire(timeout=60)
    push_pair(made.stream, 3)
    made.stream.close()
    assert seen == [0, 1, 2]
    assert add_up(made.stream.counts).dropped == {"closed": 2}
    with pytest.raises(InputError, match="on_result"):
        iter(made.stream)


def test_an_unexpected_error_ends_the_stream_and_reaches_on_error_the_pushes_and_close(setup):
    reported, heard = [], threading.Event()

    def hear(error):
        reported.append(error)
        heard.set()

    made = setup(on_error=hear)
    failure = made.predictor.fail_with = ZeroDivisionError("a bug")
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    push_pair(made.stream, 1)
    made.predictor.gate.set()
    assert heard.wait(60)
    for _ in range(2):
        with pytest.raises(InferenceError, match=r"a bug.*make a new one") as raised:
            made.stream.push_image(image(), 2)
        assert raised.value.__cause__ is failure
    with pytest.raises(ZeroDivisionError):
        made.stream.close()
    made.stream.close()
    assert reported == [failure]
    counts = add_up(made.stream.counts)
    assert (counts.pending, counts.dropped["closed"]) == (0, 4)
    assert counts.errors == {"inference_error": 2}


def test_an_error_of_the_callback_ends_the_stream_and_comes_out_at_close(setup):
    stream = setup(on_result=lambda result: 1 / 0).stream

    def push_until_it_raises():
        for number in range(10_000):
            push_pair(stream, number)

    with (
        pytest.raises(ZeroDivisionError),
        stream,
        pytest.raises(InferenceError, match="ZeroDivisionError"),
    ):
        push_until_it_raises()
    stream.close()
    assert add_up(stream.counts).pending == 0


def test_an_error_of_the_block_is_not_hidden_by_one_of_the_callback(setup):
    def work():
        with setup(on_result=lambda result: 1 / 0).stream as stream:
            push_pair(stream, 0)
            raise KeyError

    with pytest.raises(KeyError):
        work()


# --- a stream that nobody closes ----------------------------------------------------------------

EXIT_WITH_AN_OPEN_STREAM = """
import time
import numpy as np
from runtime import Predictor, PushStream
predictor = Predictor("ssdnet-nano", threads=1, warmup=0)
stream = PushStream(predictor, max_wait_ms=0)
stream.push_image(np.zeros((375, 1242, 3), np.uint8), 0)
time.sleep(0.01)
print("end")
"""


def test_dropped_streams_end_their_threads(checked_predictor):
    before = set(threading.enumerate())
    streams = [PushStream(checked_predictor()) for _ in range(50)]
    alive = weakref.WeakSet(streams)
    workers = set(threading.enumerate()) - before
    assert len(workers) == 50
    for stream in streams:
        stream.itself = stream  # a cycle, as in a node whose method is on_result
    del streams, stream
    gc.collect()
    assert not alive
    for worker in workers:
        worker.join(20)
        assert not worker.is_alive()


def test_the_interpreter_may_exit_with_a_stream_open():
    command = [sys.executable, "-c", EXIT_WITH_AN_OPEN_STREAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "end\n", "")
