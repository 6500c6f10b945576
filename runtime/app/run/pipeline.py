"""Running a stream: while a frame is answered, the next is read and the last one written."""

import contextlib
import ctypes
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2

from runtime.app.run.frame_record import FrameRecord
from runtime.app.run.options import RunOptions
from runtime.base.errors import SSDNetError
from runtime.base.stamp import NS_PER_MS
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
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


OnRecord = Callable[[FrameRecord], None]  # is called with the record of each frame


@dataclass(frozen=True)
class StreamResult:
    """The outcome of a stream.

    Attributes:
        records: the frames, in order.
        wall_s: time from the first read to the last write.
        interrupted: whether `stop` ended the stream.
    """

    records: tuple[FrameRecord, ...]
    wall_s: float
    interrupted: bool


class FrameReader:
    """Reads the frames of a source, the first ones only once for warm-up, check and run."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._kept: dict[int, tuple[Frame, float]] = {}

    def __call__(self, listed: ListedFrame, *, keep: bool = False) -> tuple[Frame, float]:
        """Read a frame unless it is kept; return it and the time that reading took [ms].

        With `keep`, the frame is kept until it is read again. Raises InputError.
        """
        timed = self._kept.pop(listed.sequence, None)
        if timed is None:
            started = time.perf_counter()
            frame = self._source.read(listed)
            timed = frame, (time.perf_counter() - started) * 1e3
        if keep:
            self._kept[listed.sequence] = timed
        return timed


class Output(Protocol):
    """Where the answers of a run are written.

    An output is made by a context manager. What it writes gets its name, complete, when the block
    ends, and is removed after an error in the block.
    """

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Write the answer to a frame; always called from the same thread. Raises OutputError."""


@dataclass(frozen=True)
class Outputs:
    """The outputs of a run.

    Attributes:
        writers: they get each valid answer, in the writing thread.
        recorders: they get each answer, valid or not, in the calling thread, while nothing is
            predicted.
    """

    writers: Sequence[Output] = ()
    recorders: Sequence[Output] = ()


class _Reading(NamedTuple):
    """A frame that is being read, and the time of `perf_counter` at which it is due, if any."""

    listed: ListedFrame
    timed: Future[tuple[Frame, float]]
    due: float | None


class StreamRun:
    """Answers every frame of a stream, in order.

    One thread reads ahead and one writes behind. Each holds at most two frames, so memory does not
    grow. A frame that cannot be read or predicted is skipped.

    Args:
        answerer: answers the frames, in the calling thread.
        read: reads them in order, in the reading thread.
        options: with --rate, frames are due at this rate from the start on, and none is predicted
            earlier (MLPerf's constant stream); without it, each frame is due when the one before is
            done (single stream). --deadline-ms is the limit of the latency.
        outputs: where the answers are written.
        on_record: called with the record of each frame when it is done.
        stop: called before each frame; True ends the stream.
    """

    def __init__(
        self,
        answerer: Answerer,
        read: FrameReader,
        options: RunOptions,
        outputs: Outputs,
        on_record: OnRecord,
        stop: Callable[[], bool],
    ) -> None:
        self._answerer, self._read, self._on_record, self._stop = answerer, read, on_record, stop
        self._outputs, self._options = outputs, options
        self._jitter = Jitter()
        self._reads: deque[_Reading] = deque()
        self._writes: deque[tuple[FrameRecord, Future[float] | None]] = deque()
        self._records: list[FrameRecord] = []
        self._reader, self._writer = (
            ThreadPoolExecutor(1, thread_name_prefix=name, initializer=_lower_priority)
            for name in ("read", "write")
        )

    def run(self, frames: Iterable[ListedFrame]) -> StreamResult:
        """Answer the frames; to be called once.

        Raises:
            Exception: what an output raises ends the stream.
        """
        started, rate_hz = time.perf_counter(), self._options.rate
        waiting = (
            (listed, None if rate_hz is None else started + number / rate_hz)
            for number, listed in enumerate(frames)
        )
        try:
            for _ in range(_READ_AHEAD):
                self._read_next(waiting)
            while self._reads and not self._stop() and self._wait_until(self._reads[0].due):
                self._writes.append(self._answer(self._reads.popleft()))
                self._read_next(waiting)
                self._answerer.check_last(idle=True)
                self._finish_all_but(_WRITE_BEHIND)
            self._finish_all_but(0)
        finally:
            self._reader.shutdown(cancel_futures=True)
            self._writer.shutdown(cancel_futures=True)
        wall_s = time.perf_counter() - started
        return StreamResult(tuple(self._records), wall_s, bool(self._reads))

    def _read_next(self, waiting: Iterator[tuple[ListedFrame, float | None]]) -> None:
        """Start reading the next frame, if there is one."""
        for listed, due in waiting:
            self._reads.append(_Reading(listed, self._reader.submit(self._read, listed), due))
            return

    def _wait_until(self, due: float | None) -> bool:
        """Wait for a time of `perf_counter`, if any; return False if the stream ends before it."""
        while due is not None and (left := due - time.perf_counter()) > 0:
            if self._stop():
                return False
            time.sleep(min(left, _STOP_POLL_S))
        return True

    def _answer(self, reading: _Reading) -> tuple[FrameRecord, Future[float] | None]:
        """Answer a frame and start writing the answer; return the record and the write."""
        try:
            frame, read_ms = reading.timed.result()
            frame, result = self._answerer.answer(frame)
        except SSDNetError as error:
            name, stamp_ns = reading.listed.name, reading.listed.image_stamp_ns
            return FrameRecord(name=name, reason=str(error), image_stamp_ns=stamp_ns), None
        times_ms = {"read": read_ms}
        if reading.due is not None:
            times_ms["age"] = age_ms = (time.perf_counter() - reading.due) * 1e3
            if (jitter_ms := self._jitter.record(round(age_ms * NS_PER_MS))) is not None:
                times_ms["jitter"] = jitter_ms
        record = FrameRecord.of(result, times_ms, self._options.deadline_ms)
        for recorder in self._outputs.recorders:
            recorder.write(frame, result)
        if not (self._outputs.writers and result.prediction.valid):
            return record, None
        return record, self._writer.submit(_write, self._outputs.writers, frame, result)

    def _finish_all_but(self, count: int) -> None:
        """Wait until all answers but the last `count` are written, and keep their records."""
        while len(self._writes) > count:
            record, written = self._writes.popleft()
            record = record if written is None else record.written(written.result())
            self._records.append(record)
            self._on_record(record)


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
