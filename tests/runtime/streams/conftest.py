"""A clock that stands still until a test moves it, and a predictor whose answers are known.

No test with them sleeps: the clock is moved by hand, and a prediction lasts until its gate is
opened.
"""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from runtime.contract.canonical_focal import CameraScale
from runtime.engine.prediction import Latency, Prediction
from runtime.engine.preprocess import preprocess
from runtime.streams.push_stream import PushStream

pytest.register_assert_rewrite("stream_messages")  # so that `add_up` shows the counts

MS = 1_000_000


class ManualClock:
    """Moved by the test alone; a thread that waits for a time wakes up when it is reached."""

    def __init__(self):
        self._now_ns = 0
        self._conditions = set()
        self._lock = threading.Lock()

    def now_ns(self):
        return self._now_ns

    def wait(self, changed, timeout_ns):
        with self._lock:
            self._conditions.add(changed)
        if timeout_ns is None or timeout_ns > 0:
            assert changed.wait(60), "a test that hangs fails"

    def advance_ms(self, milliseconds):
        with self._lock:
            conditions = list(self._conditions)
            self._now_ns += round(milliseconds * MS)
        for changed in conditions:
            with changed:
                changed.notify_all()


class CheckedPredictor:
    """Checks a frame as the engine does and answers depth + 1.

    gate: predictions wait until it is set; `gate.clear()` holds them
    """

    focal_length_px = None

    def __init__(self):
        self.gate = threading.Event()
        self.gate.set()
        self.entered = threading.Semaphore(0)
        self.clock = None
        self.takes_ms = 0
        self.fail_with = None
        self.focal_lengths_px = []
        self.shares = []  # of the pixels with a return, of each prediction

    def predict(self, rgb, sparse_depth, *, stamp=None, focal_length_px=None):
        self.focal_lengths_px.append(focal_length_px)
        self.shares.append(np.count_nonzero(sparse_depth) / sparse_depth.size)
        self.entered.release()
        assert self.gate.wait(60)
        if self.fail_with is not None:
            raise self.fail_with
        scale = CameraScale(factor=1.0, range_m=80.0, focal_length_px=None)
        frame = preprocess(
            rgb, sparse_depth, size_for=lambda size: size, scale_for=lambda size: scale
        )
        if self.takes_ms:
            self.clock.advance_ms(self.takes_ms)
        return Prediction(
            heads={"depth": frame.sparse_depth + 1},
            frame_size=frame.frame_size,
            network_size=frame.network_size,
            latency=Latency(0, 0, 0, 0),
            degraded=frame.degraded,
            depth_returns=frame.depth_returns,
            stamp=stamp,
        )


@pytest.fixture(scope="session")
def checked_predictor():
    """The class."""
    return CheckedPredictor


@pytest.fixture
def setup():
    """Make a stream on a manual clock: `.stream`, `.clock`, `.predictor`. Closed at the end.

    Without `check_depth` the predictor is asked once a frame.
    """
    made, before = [], set(threading.enumerate())

    def make(*, check_depth=False, **options):
        clock, predictor = ManualClock(), CheckedPredictor()
        predictor.clock = clock
        stream = PushStream(predictor, clock=clock, check_depth=check_depth, **options)
        made.append((stream, predictor))
        return SimpleNamespace(stream=stream, clock=clock, predictor=predictor)

    yield make
    for stream, predictor in made:
        predictor.gate.set()
        stream.close()
    assert set(threading.enumerate()) <= before
