"""The end of a stream that nobody closes, or that a signal handler closes."""

import gc
import subprocess
import sys
import threading
import weakref

import pytest

from runtime.streams.push_stream import PushStream

CLOSED_BY_A_SIGNAL = """
import signal, threading, time
import numpy as np
from runtime.streams.push_stream import PushStream
from runtime.prediction import Latency, Prediction

class Stub:
    focal_length_px = None

    def predict(self, rgb, sparse_depth, **options):
        size, latency = sparse_depth.shape, Latency(0, 0, 0, 0)
        return Prediction({"depth": sparse_depth}, size, size, latency)

def push():
    stream.push_image(rgb, number / 10)
    stream.push_depth(depth, number / 10)

def count():
    stream.counts

def fetch():
    push()
    next(stream, None)

rgb, depth = np.zeros((32, 40, 3), np.uint8), np.ones((32, 40), np.float32)
signal.signal(signal.SIGALRM, lambda *_: (stream.close(), closed.append(True)))
for repetition in range(50):
    stream, closed, number = PushStream(Stub(), on_result=ON_RESULT), [], 0
    signal.setitimer(signal.ITIMER_REAL, 0.002 + repetition * 1e-4)
    while not closed:
        INTERRUPTED()
        number += 1
    end = time.monotonic() + 20
    while threading.active_count() > 1 and time.monotonic() < end:
        time.sleep(0.001)
    assert threading.active_count() == 1
    assert stream.counts.pending == 0
print("done")
"""

EXIT_WITH_AN_OPEN_STREAM = """
import time
import numpy as np
from runtime import Predictor, PushStream
predictor = Predictor("ssdnet-nano", threads=1, warmup=0)
stream = PushStream(predictor, max_wait_ms=0)
stream.push_image(np.zeros((375, 1242, 3), np.uint8), 0)
time.sleep(MOMENT_S)
print("end")
"""


def run(program, **constants):
    """Run a program with some names replaced; (exit code, stdout, stderr)."""
    for name, value in constants.items():
        program = program.replace(name, str(value))
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("interrupted", "on_result"),
    [
        ("push", "None"),
        ("push", "lambda result: None"),
        ("fetch", "None"),
    ],
)
def test_a_signal_handler_may_close_the_stream(interrupted, on_result):
    """Fifty streams, each closed at another moment of a method in the same thread."""
    done = run(CLOSED_BY_A_SIGNAL, INTERRUPTED=interrupted, ON_RESULT=on_result)
    assert done == (0, "done\n", "")


def test_dropped_streams_end_their_threads(checked_predictor):
    before = set(threading.enumerate())
    streams = [PushStream(checked_predictor()) for _ in range(50)]
    alive = weakref.WeakSet(streams)
    workers = set(threading.enumerate()) - before
    assert len(workers) == 50
    for stream in streams:
        stream.itself = stream  # a cycle, as of a node whose method is on_result
    del streams, stream
    gc.collect()
    assert not alive
    for worker in workers:
        worker.join(20)
        assert not worker.is_alive()


@pytest.mark.parametrize("moment_s", [0.01, 0.02])
def test_the_interpreter_may_exit_with_a_stream_open(moment_s):
    assert run(EXIT_WITH_AN_OPEN_STREAM, MOMENT_S=moment_s) == (0, "end\n", "")
