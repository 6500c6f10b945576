"""Run a stream of frames: read the next and write the last while the present one is predicted."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

from runtime.errors import SSDNetError
from runtime.health.frame_health import FrameHealth
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.sources.source import ListedFrame
from runtime.streams.frame_outcome import FrameOutcome
from runtime.streams.statistics import Jitter
from runtime.sync.frame import Frame
from runtime.sync.stamp import NS_PER_MS

_READ_AHEAD, _WRITE_BEHIND = 2, 2  # frames held in memory on either side
_NICENESS = 10
_STOP_POLL_S = 0.1  # between two looks at `stop` while waiting

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


class Output(Protocol):
    """Where the answers of a run are written.

    An output is made by a context manager: what it writes gets its name, whole, when the block
    ends, and is removed after an error there.
    """

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Write the answer to a frame; always called from one thread. Raises OutputError."""


def run_stream(
    predictor: Predictor,
    frames: Sequence[ListedFrame],
    *,
    read: Callable[[ListedFrame], Frame],
    focal_length_px: Callable[[Frame], float | None] = lambda frame: None,
    rate_hz: float | None = None,
    deadline_ms: float | None = None,
    degraded: tuple[str, ...] = (),
    outputs: Sequence[Output] = (),
    recorders: Sequence[Output] = (),
    on_record: Callable[[FrameOutcome], None] = lambda record: None,
    stop: Callable[[], bool] = lambda: False,
) -> StreamResult:
    """Predict every frame, in order.

    One thread reads ahead and one writes behind; each holds at most two frames, so memory does not
    grow. A frame that cannot be read or predicted is skipped.

    Args:
        predictor: predicts the frames, in the calling thread.
        frames: to read.
        read: reads one of `frames`; called in order, in the reading thread.
        focal_length_px: gives that of a frame; None = the predictor's.
        rate_hz: frames are due at this rate from the start on, and none is predicted earlier
            (constant stream of MLPerf); None = each when the one before is done (single stream).
        deadline_ms: limit of `FrameOutcome.latency_ms`; None = no limit.
        degraded: reasons that hold for the whole stream, added to those of each prediction.
        outputs: get each valid answer, in the writing thread.
        recorders: get each answer as the predictor gave it, valid or not, in the calling thread,
            while nothing is predicted.
        on_record: called with the outcome of each frame when it is done.
        stop: called before each frame; True ends the stream.

    Raises:
        Exception: what an output raises ends the stream.
    """
    reads: deque[tuple[int, str, Future[TimedFrame]]] = deque()
    writes: deque[tuple[FrameOutcome, Future[float] | None]] = deque()
    records: list[FrameOutcome] = []
    waiting = iter(enumerate(frames))
    health, jitter = FrameHealth(), Jitter()

    def read_checked(listed: ListedFrame) -> TimedFrame:
        started = time.perf_counter()
        frame = read(listed)
        read_ms = (time.perf_counter() - started) * 1e3
        size, focal_px = frame.rgb.shape[:2], focal_length_px(frame)
        range_m = predictor.camera_scale(size, focal_length_px=focal_px).range_m
        found = health.check(frame.rgb, frame.sparse_depth, range_m=range_m)
        return replace(frame, name=listed.name, health=found, focal_length_px=focal_px), read_ms

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
            rgb, depth, focal_px = frame.rgb, frame.sparse_depth, frame.focal_length_px
            prediction = predictor.predict(rgb, depth, focal_length_px=focal_px)
        except SSDNetError as error:
            return FrameOutcome(sequence=index, name=name, reason=str(error)), None
        latency_ms, age_ms, jitter_ms = prediction.latency.total_ms, None, None
        if due is not None:
            latency_ms = age_ms = (time.perf_counter() - due) * 1e3
            jitter_ms = jitter.record(round(age_ms * NS_PER_MS))
        for recorder in recorders:
            recorder.write(frame, prediction)
        reason = "" if prediction.valid else ", ".join(prediction.degraded)
        prediction = prediction.after_reading(frame.degraded + degraded, frame.lost_points)
        written = None
        if outputs and prediction.valid:
            written = writing_thread.submit(_write, outputs, frame, prediction)
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
    writing_thread = ThreadPoolExecutor(1, thread_name_prefix="write", initializer=_lower_priority)
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
        writing_thread.shutdown(cancel_futures=True)
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


def _write(outputs: Sequence[Output], frame: Frame, prediction: Prediction) -> float:
    """Write to all outputs in order; return the time in ms."""
    started = time.perf_counter()
    for output in outputs:
        output.write(frame, prediction)
    return (time.perf_counter() - started) * 1e3
