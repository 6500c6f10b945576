"""Run a stream of frames: read the next and write the last while the present one is predicted."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

from runtime.errors import SSDNetError
from runtime.health.frame_health import FrameHealth
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame
from runtime.sync.frame_outcome import FrameOutcome
from runtime.sync.latency import Jitter
from runtime.sync.stamp import NS_PER_MS

_READ_AHEAD, _WRITE_BEHIND = 2, 2  # frames held in memory on either side
_NICENESS = 10
_STOP_POLL_S = 0.1  # between two looks at `stop` while waiting

WriteFrame = Callable[[Frame, Prediction], None]
TimedFrame = tuple[Frame, float]  # a frame and the ms of reading it


@dataclass(frozen=True)
class StreamResult:
    """The outcome of a stream.

    Attributes:
        records: outcomes of the frames, in order.
        wall_s: from the first read to the last write.
        interrupted: whether `stop` ended the stream.
        rate_hz: of a constant stream; None = a single stream.
    """

    records: tuple[FrameOutcome, ...]
    wall_s: float
    interrupted: bool
    rate_hz: float | None = None


class FrameReader:
    """Reads each frame of a source once, also those that are needed before the stream.

    Args:
        read: reads a frame; raises an SSDNetError where it cannot be read.
    """

    def __init__(self, read: Callable[[ListedFrame], Frame]) -> None:
        self._read = read
        self._kept: dict[int, TimedFrame | SSDNetError] = {}

    def peek(self, listed: ListedFrame) -> Frame:
        """Read a frame, and keep it for `take`. Raises what reading raises."""
        if listed.sequence not in self._kept:
            try:
                self._kept[listed.sequence] = self.take(listed)
            except SSDNetError as error:
                self._kept[listed.sequence] = error
        kept = self._kept[listed.sequence]
        if isinstance(kept, SSDNetError):
            raise kept
        return kept[0]

    def take(self, listed: ListedFrame) -> TimedFrame:
        """Return a frame, and how long it was read in ms."""
        kept = self._kept.pop(listed.sequence, None)
        if isinstance(kept, SSDNetError):
            raise kept
        if kept is not None:
            return kept
        started = time.perf_counter()
        frame = self._read(listed)
        return frame, (time.perf_counter() - started) * 1e3


def run_stream(
    predictor: Predictor,
    frames: Sequence[ListedFrame],
    *,
    reader: FrameReader,
    rate_hz: float | None = None,
    deadline_ms: float | None = None,
    degraded: tuple[str, ...] = (),
    write: WriteFrame | None = None,
    record: WriteFrame | None = None,
    on_record: Callable[[FrameOutcome], None] = lambda record: None,
    stop: Callable[[], bool] = lambda: False,
) -> StreamResult:
    """Predict every frame, in order.

    One thread reads ahead and one writes behind; each holds at most two frames, so memory does not
    grow. A frame that cannot be read or predicted is skipped.

    Args:
        predictor: predicts the frames, in the calling thread.
        frames: to read.
        reader: of `frames`, in order, in the reading thread.
        rate_hz: frames are due at this rate from the start on, and none is predicted earlier
            (constant stream of MLPerf); None = each when the one before is done (single stream).
        deadline_ms: limit of `FrameOutcome.latency_ms`; None = no limit.
        degraded: reasons that hold for the whole stream, added to those of each prediction.
        write: called with each valid answer in the writing thread; None = nothing is written.
        record: called with each answer as the predictor gave it, valid or not, in the calling
            thread, while nothing is predicted; None = nothing is recorded.
        on_record: called with the outcome of each frame when it is done.
        stop: called before each frame; True ends the stream.

    Raises:
        Exception: what `write` and `record` raise ends the stream.
    """
    reads: deque[tuple[int, str, Future[TimedFrame]]] = deque()
    writes: deque[tuple[FrameOutcome, Future[float] | None]] = deque()
    records: list[FrameOutcome] = []
    waiting = iter(enumerate(frames))
    health, jitter = FrameHealth(), Jitter()

    def read_checked(listed: ListedFrame) -> TimedFrame:
        frame, read_ms = reader.take(listed)
        scale = predictor.camera_scale((frame.rgb.shape[0], frame.rgb.shape[1]))
        found = health.check(frame.rgb, frame.sparse_depth, range_m=scale.range_m)
        return replace(frame, name=listed.name, health=found), read_ms

    def read_next() -> None:
        for index, listed in waiting:
            reads.append((index, listed.name, reading_thread.submit(read_checked, listed)))
            return

    def answer(
        index: int, name: str, reading: Future[TimedFrame], due: float | None
    ) -> tuple[FrameOutcome, Future[float] | None]:
        """Predict a frame and start writing its answer; return the outcome and the write."""
        try:
            frame, read_ms = reading.result()
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
        except SSDNetError as error:
            return FrameOutcome(sequence=index, name=name, reason=str(error)), None
        latency_ms, age_ms, jitter_ms = prediction.latency.total_ms, None, None
        if due is not None:
            latency_ms = age_ms = (time.perf_counter() - due) * 1e3
            jitter_ms = jitter.record(round(age_ms * NS_PER_MS))
        if record is not None:
            record(frame, prediction)
        reason = "" if prediction.valid else ", ".join(prediction.degraded)
        prediction = replace(prediction, degraded=prediction.degraded + frame.degraded + degraded)
        written = None
        if write is not None and prediction.valid:
            written = writer.submit(_timed_write, write, frame, prediction)
        outcome = FrameOutcome(
            sequence=index,
            name=name,
            reason=reason,
            prediction=replace(prediction, heads={}),
            health=frame.health,
            image_stamp=frame.image_stamp_ns,
            depth_stamp=frame.depth_stamp_ns,
            depth_reused=frame.depth_reused,
            depth_motion=frame.depth_motion,
            read_ms=read_ms,
            latency_ms=latency_ms,
            age_ms=age_ms,
            jitter_ms=jitter_ms,
            deadline_met=None if deadline_ms is None else latency_ms <= deadline_ms,
        )
        return outcome, written

    def finish_oldest() -> None:
        done, written = writes.popleft()
        done = done if written is None else replace(done, write_ms=written.result())
        records.append(done)
        on_record(done)

    reading_thread = ThreadPoolExecutor(1, thread_name_prefix="read", initializer=_lower_priority)
    writer = ThreadPoolExecutor(1, thread_name_prefix="write", initializer=_lower_priority)
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
            writes.append(answer(index, name, reading, due))
            read_next()
            while len(writes) > _WRITE_BEHIND:
                finish_oldest()
        while writes:
            finish_oldest()
    finally:
        reading_thread.shutdown(cancel_futures=True)
        writer.shutdown(cancel_futures=True)
    wall_s = time.perf_counter() - started
    return StreamResult(tuple(records), wall_s, bool(reads), rate_hz)


def _wait_until(due: float, stop: Callable[[], bool]) -> bool:
    """Wait for a time of `perf_counter`. Returns False if `stop` became True before."""
    while (left := due - time.perf_counter()) > 0:
        if stop():
            return False
        time.sleep(min(left, _STOP_POLL_S))
    return True


def _lower_priority() -> None:
    """Let the calling thread run only where inference leaves the processor idle.

    The threads of an operator wait for the slowest of them, so a millisecond that one of them loses
    to a decoder is lost to all.
    """
    if sys.platform == "linux":  # on other systems nice() changes the whole process
        os.nice(_NICENESS)


def _timed_write(write: WriteFrame, frame: Frame, prediction: Prediction) -> float:
    started = time.perf_counter()
    write(frame, prediction)
    return (time.perf_counter() - started) * 1e3
