"""Running a stream: while a frame is answered, the next is read and the last one written."""

import contextlib
import ctypes
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

import cv2

from runtime.app.run.options import RunOptions
from runtime.base.errors import SSDNetError
from runtime.base.stamp import NS_PER_MS
from runtime.recordings.source import ListedFrame, Source
from runtime.streams.answerer import Answerer
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult
from runtime.streams.statistics import Jitter

_READ_AHEAD, _WRITE_BEHIND = 2, 2  # frames held in memory on either side
_NICENESS = 10
_STOP_POLL_S = 0.1  # interval between two calls of `stop` while waiting
# Names and numbers of mallopt (malloc.h of glibc).
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BUFFER_BYTES = 32 << 20  # the largest value that glibc accepts
_KEPT_FREE_BYTES = 256 << 20


def dedicate_process() -> None:
    """Give the cores to inference, and keep freed memory for the next frame.

    This changes OpenCV and the allocator of the whole process. It is meant for ssdnet-run and
    benchmarks, not for a program that embeds a Predictor.
    """
    cv2.setNumThreads(1)  # more threads would compete with those of an operator
    # Files that cannot be decoded are reported as skipped frames, so OpenCV prints nothing.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    # glibc would return the memory of a freed picture, and the kernel would clear every page of the
    # next one. Other C libraries have no mallopt.
    with contextlib.suppress(AttributeError, OSError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BUFFER_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_FREE_BYTES)


@dataclass(frozen=True)
class StreamResult:
    """The outcome of a stream.

    Attributes:
        records: results of the frames, in order, without arrays.
        wall_s: time from the first read to the last write.
        interrupted: whether `stop` ended the stream.
    """

    records: tuple[FrameResult, ...]
    wall_s: float
    interrupted: bool


class ReadFrame(Protocol):
    """Reads a frame; returns it and the time that reading took [ms]. Raises InputError."""

    def __call__(self, listed: ListedFrame, *, keep: bool = False) -> tuple[Frame, float]:
        """Read a frame unless it is kept; with `keep`, it is kept until it is read again."""


def frame_reader(source: Source) -> ReadFrame:
    """Return a function that reads frames, the first ones only once for warm-up, check and run."""
    kept: dict[int, tuple[Frame, float]] = {}

    def read(listed: ListedFrame, *, keep: bool = False) -> tuple[Frame, float]:
        timed = kept.pop(listed.sequence, None)
        if timed is None:
            started = time.perf_counter()
            frame = source.read(listed)
            timed = frame, (time.perf_counter() - started) * 1e3
        if keep:
            kept[listed.sequence] = timed
        return timed

    return read


class Output(Protocol):
    """Where the answers of a run are written.

    An output is made by a context manager. What it writes gets its name, complete, when the block
    ends, and is removed after an error in the block.
    """

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Write the answer to a frame; always called from the same thread. Raises OutputError."""


def run_stream(
    answerer: Answerer,
    frames: Sequence[ListedFrame],
    read: ReadFrame,
    options: RunOptions,
    *,
    outputs: Sequence[Output] = (),
    recorders: Sequence[Output] = (),
    on_record: Callable[[FrameResult], None] = lambda record: None,
    stop: Callable[[], bool] = lambda: False,
) -> StreamResult:
    """Answer every frame, in order.

    One thread reads ahead and one writes behind. Each holds at most two frames, so memory does not
    grow. A frame that cannot be read or predicted is skipped.

    Args:
        answerer: answers the frames, in the calling thread.
        frames: the frames to read.
        read: reads them in order, in the reading thread.
        options: with --rate, frames are due at this rate from the start on, and none is predicted
            earlier (MLPerf's constant stream); without it, each frame is due when the one before is
            done (single stream). --deadline-ms is the limit of `FrameResult.latency_ms`.
        outputs: they get each valid answer, in the writing thread.
        recorders: they get each answer, valid or not, in the calling thread, while nothing is
            predicted.
        on_record: called with the result of each frame when it is done.
        stop: called before each frame; True ends the stream.

    Raises:
        Exception: what an output raises ends the stream.
    """
    reads: deque[tuple[int, ListedFrame, Future[tuple[Frame, float]]]] = deque()
    writes: deque[tuple[FrameResult, Future[float] | None]] = deque()
    records: list[FrameResult] = []
    waiting, rate_hz, deadline_ms = iter(enumerate(frames)), options.rate, options.deadline_ms
    jitter = Jitter()

    def read_next() -> None:
        for index, listed in waiting:
            reads.append((index, listed, reading_thread.submit(read, listed)))
            return

    def answer(
        index: int, listed: ListedFrame, reading: Future[tuple[Frame, float]], due: float | None
    ) -> tuple[FrameResult, Future[float] | None]:
        """Answer a frame and start writing the answer; return the result and the write."""
        try:
            frame, read_ms = reading.result()
            result = answerer.answer(frame)
        except SSDNetError as error:
            reason, stamp_ns = str(error), listed.image_stamp_ns
            skipped = FrameResult(sequence=index, name=listed.name, reason=reason)
            return skipped if stamp_ns is None else replace(skipped, image_stamp=stamp_ns), None
        record = replace(result.in_report(index), read_ms=read_ms)
        if due is not None:
            age_ms = (time.perf_counter() - due) * 1e3
            jitter_ms = jitter.record(round(age_ms * NS_PER_MS))
            record = replace(record, latency_ms=age_ms, age_ms=age_ms, jitter_ms=jitter_ms)
        if deadline_ms is not None:
            record = replace(record, deadline_met=record.latency_ms <= deadline_ms)
        for recorder in recorders:
            recorder.write(frame, result)
        written = None
        if outputs and result.prediction.valid:
            written = writing_thread.submit(_write, outputs, frame, result)
        return record, written

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
            index, listed, reading = reads[0]
            due = None if rate_hz is None else started + index / rate_hz
            if due is not None and not _wait_until(due, stop):
                break
            reads.popleft()
            writes.append(answer(index, listed, reading, due))
            read_next()
            answerer.check_last(idle=True)
            while len(writes) > _WRITE_BEHIND:
                finish_oldest()
        while writes:
            finish_oldest()
    finally:
        reading_thread.shutdown(cancel_futures=True)
        writing_thread.shutdown(cancel_futures=True)
    wall_s = time.perf_counter() - started
    return StreamResult(tuple(records), wall_s, bool(reads))


def _wait_until(due: float, stop: Callable[[], bool]) -> bool:
    """Wait for a time of `perf_counter`. Returns False if `stop` became True before that time."""
    while (left := due - time.perf_counter()) > 0:
        if stop():
            return False
        time.sleep(min(left, _STOP_POLL_S))
    return True


def _lower_priority() -> None:
    """Let the calling thread run only while inference leaves the processor idle.

    The threads of an operator wait for the slowest one, so a millisecond that one of them loses to
    a decoder is lost to all.
    """
    if sys.platform == "linux":  # on other systems nice() changes the whole process
        os.nice(_NICENESS)


def _write(outputs: Sequence[Output], frame: Frame, result: FrameResult) -> float:
    """Write to all outputs in order; return the time in ms."""
    started = time.perf_counter()
    for output in outputs:
        output.write(frame, result)
    return (time.perf_counter() - started) * 1e3
