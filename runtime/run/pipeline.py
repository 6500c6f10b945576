"""Run a stream of frames: read the next and write the last while the present one is predicted."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from runtime.errors import SSDNetError
from runtime.prediction import Cleaned, Latency, Prediction
from runtime.sources.frames import Frame
from runtime.sync.latency import Jitter
from runtime.sync.stamp import NS_PER_MS

OK, SKIPPED, INVALID = "ok", "skipped", "invalid"
_READ_AHEAD, _WRITE_BEHIND = 2, 2  # frames held in memory on either side
_NICENESS = 10
_STOP_ASKED_S = 0.1  # so often while waiting

TakeFrame = Callable[[str, Frame, Prediction], None]


class ListedFrame(Protocol):
    """A frame that is known of, but not read yet."""

    @property
    def name(self) -> str:
        """Of the frame and of its answers' files."""


Listed = TypeVar("Listed", bound=ListedFrame)


class PredictsFrames(Protocol):
    """What a stream needs of a `Predictor` or a `CompletionPredictor`."""

    def predict(self, rgb: NDArray[np.uint8], sparse_depth: NDArray[np.float32]) -> Prediction:
        """Answer one frame."""


@dataclass(frozen=True)
class FrameRecord:
    """What became of one frame of a stream.

    status: "ok"; "skipped": not predicted, `reason` says why; "invalid": the answer could not be
        used and was not written, `reason` says why
    image_stamp_ns, depth_stamp_ns: when the sensors took it, by their own clock; None = not known
    age_ms: constant stream: from when the frame was due until its answer was there
    jitter_ms: constant stream: by how much the age changed since the answer before, the
        transit-time difference of RFC 3550
    """

    index: int
    name: str
    status: str
    reason: str = ""
    frame_size: tuple[int, int] | None = None
    network_size: tuple[int, int] | None = None
    read_ms: float | None = None
    latency: Latency | None = None
    write_ms: float | None = None
    degraded: tuple[str, ...] = ()
    cleaned: Cleaned = field(default_factory=Cleaned)
    depth_returns: int = 0
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    age_ms: float | None = None
    jitter_ms: float | None = None

    @property
    def skew_ms(self) -> float | None:
        """By how much the stamps of the two sensors lie apart; None where one is not known."""
        if self.image_stamp_ns is None or self.depth_stamp_ns is None:
            return None
        return abs(self.depth_stamp_ns - self.image_stamp_ns) / 1e6

    @property
    def response_ms(self) -> float | None:
        """What a deadline is held against: the age, in a single stream the prediction's time."""
        if self.age_ms is not None or self.latency is None:
            return self.age_ms
        return self.latency.total_ms


@dataclass(frozen=True)
class StreamResult:
    """The records in order, the time from first read to last write, whether it was stopped.

    rate_hz: of a constant stream; None = a single stream
    """

    records: tuple[FrameRecord, ...]
    wall_s: float
    interrupted: bool
    rate_hz: float | None = None


def run_stream(
    predictor: PredictsFrames,
    frames: Sequence[Listed],
    *,
    read: Callable[[Listed], Frame],
    rate_hz: float | None = None,
    write: TakeFrame | None = None,
    keep: TakeFrame = lambda name, frame, prediction: None,
    on_record: Callable[[FrameRecord], None] = lambda record: None,
    stop: Callable[[], bool] = lambda: False,
) -> StreamResult:
    """Predict every frame, in order.

    One thread reads ahead and one writes behind; both hold at most two frames, so memory does not
    grow. A frame that cannot be read or predicted is recorded and skipped.

    read: is called with each of `frames`, in order, in the reading thread; an SSDNetError says why
        a frame cannot be read
    rate_hz: frames are due so often, from the start on, and none is predicted earlier: MLPerf's
        constant stream; None = each as soon as the one before is done: its single stream
    write: is called with (name, frame, prediction) in the writing thread; None = nothing is written
    keep: is called with (name, frame, prediction) right after each prediction, valid or not, and
        no other is made meanwhile
    on_record: is called with each record when its frame is done
    stop: is asked before each frame; once it says True, what was predicted is written and the
        records so far come back. (A KeyboardInterrupt could come between a frame's writing and its
        record: it is passed on, and what was written is not known.)

    Raises what `write` and `keep` raise (OutputError), after the frames before it were written.
    """
    records: list[FrameRecord] = []
    reads: deque[tuple[int, str, Future[tuple[Frame, float]]]] = deque()
    writes: deque[tuple[FrameRecord, Future[float] | None]] = deque()
    waiting = iter(enumerate(frames))

    def read_next() -> None:
        for index, listed in waiting:
            reads.append((index, listed.name, reader.submit(_timed_read, read, listed)))
            return

    def finish_oldest() -> None:
        record, written = writes.popleft()
        record = record if written is None else replace(record, write_ms=written.result())
        records.append(record)
        on_record(record)

    reader = ThreadPoolExecutor(1, thread_name_prefix="read", initializer=_give_way)
    writer = ThreadPoolExecutor(1, thread_name_prefix="write", initializer=_give_way)
    jitter = Jitter()
    started = time.perf_counter()
    try:
        for _ in range(_READ_AHEAD):
            read_next()
        while reads and not stop():
            index, name, reading = reads[0]
            due = None if rate_hz is None else started + index / rate_hz
            if due is not None and not _wait_until(due, stop):
                break
            reads.popleft()
            record, written = _predict(predictor, index, name, reading, writer, write, keep, due)
            if record.age_ms is not None:
                record = replace(record, jitter_ms=jitter.record(round(record.age_ms * NS_PER_MS)))
            writes.append((record, written))
            read_next()
            while len(writes) > _WRITE_BEHIND:
                finish_oldest()
        while writes:
            finish_oldest()
    finally:
        reader.shutdown(cancel_futures=True)
        writer.shutdown(cancel_futures=True)
    wall_s = time.perf_counter() - started
    return StreamResult(tuple(records), wall_s, bool(reads), rate_hz)


def _wait_until(due: float, stop: Callable[[], bool]) -> bool:
    """Wait for a time of `perf_counter`. Returns False as soon as it is asked to stop."""
    while (left := due - time.perf_counter()) > 0:
        if stop():
            return False
        time.sleep(min(left, _STOP_ASKED_S))
    return True


def _predict(
    predictor: PredictsFrames,
    index: int,
    name: str,
    reading: "Future[tuple[Frame, float]]",
    writer: ThreadPoolExecutor,
    write: TakeFrame | None,
    keep: TakeFrame,
    due: float | None,
) -> tuple[FrameRecord, "Future[float] | None"]:
    """The record of one frame, and its answer on the way to the disk.

    due: when the frame was, of a constant stream, by `perf_counter`
    """
    try:
        frame, read_ms = reading.result()
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    except SSDNetError as error:
        return FrameRecord(index, name, SKIPPED, reason=str(error)), None
    age_ms = None if due is None else (time.perf_counter() - due) * 1e3
    keep(name, frame, prediction)
    record = FrameRecord(
        index,
        name,
        OK if prediction.valid else INVALID,
        reason="" if prediction.valid else ", ".join(prediction.degraded),
        frame_size=prediction.frame_size,
        network_size=prediction.network_size,
        read_ms=read_ms,
        latency=prediction.latency,
        degraded=prediction.degraded,
        cleaned=prediction.cleaned,
        depth_returns=prediction.depth_returns,
        image_stamp_ns=frame.image_stamp_ns,
        depth_stamp_ns=frame.depth_stamp_ns,
        age_ms=age_ms,
    )
    if write is None or not prediction.valid:
        return record, None
    return record, writer.submit(_timed_write, write, name, frame, prediction)


def _give_way() -> None:
    """Let the calling thread run where inference leaves the processor idle.

    The threads of an operator wait for the slowest of them: each millisecond that one of them
    loses to a decoder is lost to all.
    """
    if sys.platform == "linux":  # elsewhere nice() is of the whole process
        os.nice(_NICENESS)


def _timed_read(read: Callable[[Listed], Frame], listed: Listed) -> tuple[Frame, float]:
    started = time.perf_counter()
    frame = read(listed)
    return frame, (time.perf_counter() - started) * 1e3


def _timed_write(write: TakeFrame, name: str, frame: Frame, prediction: Prediction) -> float:
    started = time.perf_counter()
    write(name, frame, prediction)
    return (time.perf_counter() - started) * 1e3
