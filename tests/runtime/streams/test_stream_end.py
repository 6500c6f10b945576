"""The end of a stream that nobody closes."""

import gc
import subprocess
import sys
import threading
import weakref

from runtime.streams.push_stream import PushStream

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
