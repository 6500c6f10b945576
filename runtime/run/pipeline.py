"""Run a stream of frames: read the next and write the last while the present one is predicted."""

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

from runtime.errors import SSDNetError
from runtime.health.frame_health import FrameHealth
from runtime.prediction import Cleaned, Latency, Prediction
from runtime.predictor import Predictor
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame
from runtime.sync.depth_in_time import DepthMotion
from runtime.sync.latency import Jitter
from runtime.sync.stamp import NS_PER_MS

OK, SKIPPED, INVALID = "ok", "skipped", "invalid"
_READ_AHEAD, _WRITE_BEHIND = 2, 2  # frames held in memory on either side
_NICENESS = 10
_STOP_POLL_S = 0.1  # between two looks at `stop` while waiting

WriteFrame = Callable[[Frame, Prediction], None]
TimedFrame = tuple[Frame, float]  # with the ms of reading it


@dataclass(frozen=True)
class FrameRecord:
    """The outcome of one frame of a stream.

    Attributes:
        index: position in the stream.
        name: of the frame.
        status: "ok"; "skipped": could not be read or predicted; "invalid": was predicted, but the
            answer cannot be used and was not written.
        reason: why the status is not "ok".
        frame_size: (height, width) of the frame.
        network_size: (height, width) at which the network ran.
        read_ms: time of reading and decoding.
        latency: of the prediction.
        write_ms: time of writing to all outputs.
        degraded: see `Prediction`.
        health: what `runtime.health` found in the frame.
        cleaned: see `Prediction`.
        depth_returns: see `Prediction`.
        image_stamp_ns: clock of the sensor; None = not known.
        depth_stamp_ns: clock of the sensor; None = not known.
        depth_reused: as of `Frame`.
        depth_motion: as of `Frame`.
        age_ms: constant stream: from when the frame was due until it was predicted.
        jitter_ms: constant stream: difference to the age of the frame before, the transit-time
            difference of RFC 3550.
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
    health: tuple[str, ...] = ()
    cleaned: Cleaned = field(default_factory=Cleaned)
    depth_returns: int = 0
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    depth_reused: bool = False
    depth_motion: DepthMotion | None = None
    age_ms: float | None = None
    jitter_ms: float | None = None

    @property
    def skew_ms(self) -> float | None:
        """Difference of the stamps of an image and its own depth; None where one is not known."""
        return None if self.depth_age_ms is None or self.depth_reused else abs(self.depth_age_ms)

    @property
    def depth_age_ms(self) -> float | None:
        """Image stamp - depth stamp; None where one is not known."""
        if self.image_stamp_ns is None or self.depth_stamp_ns is None:
            return None
        return (self.image_stamp_ns - self.depth_stamp_ns) / 1e6

    @property
    def depth_source(self) -> str:
        """Depth of the image's "own" scan, "reused" from an older one, or "" without depth."""
        if self.depth_motion is None:
            return ""
        return "reused" if self.depth_reused else "own"

    @property
    def response_ms(self) -> float | None:
        """What the deadline limits: the age, in a single stream the time of the prediction."""
        if self.age_ms is not None or self.latency is None:
            return self.age_ms
        return self.latency.total_ms


@dataclass(frozen=True)
class StreamResult:
    """The outcome of a stream.

    Attributes:
        records: of the frames, in order.
        wall_s: from the first read to the last write.
        interrupted: whether `stop` ended the stream.
        rate_hz: of a constant stream; None = a single stream.
    """

    records: tuple[FrameRecord, ...]
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
        """Return a frame under its name, and how long it was read in ms."""
        kept = self._kept.pop(listed.sequence, None)
        if isinstance(kept, SSDNetError):
            raise kept
        if kept is not None:
            return kept
        started = time.perf_counter()
        frame = self._read(listed)
        return replace(frame, name=listed.name), (time.perf_counter() - started) * 1e3


def answer_frame(
    predictor: Predictor, index: int, name: str, read: Callable[[], TimedFrame]
) -> tuple[FrameRecord, tuple[Frame, Prediction] | None]:
    """Read and predict one frame; return its outcome and, unless it was skipped, the answer.

    Args:
        predictor: predicts it.
        index: position of the frame in the stream.
        name: of the frame.
        read: returns what `FrameReader.take` does; an SSDNetError says why it cannot be read.
    """
    try:
        frame, read_ms = read()
        prediction = predictor.predict(frame.rgb, frame.sparse_depth)
    except SSDNetError as error:
        return FrameRecord(index, name, SKIPPED, reason=str(error)), None
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
        health=frame.health,
        cleaned=prediction.cleaned,
        depth_returns=prediction.depth_returns,
        image_stamp_ns=frame.image_stamp_ns,
        depth_stamp_ns=frame.depth_stamp_ns,
        depth_reused=frame.depth_reused,
        depth_motion=frame.depth_motion,
    )
    return record, (frame, prediction)


def run_stream(
    predictor: Predictor,
    frames: Sequence[ListedFrame],
    *,
    reader: FrameReader,
    rate_hz: float | None = None,
    degraded: tuple[str, ...] = (),
    write: WriteFrame | None = None,
    record: WriteFrame | None = None,
    on_record: Callable[[FrameRecord], None] = lambda record: None,
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
        degraded: reasons that hold for the whole stream, added to those of each prediction.
        write: called with each valid answer in the writing thread; None = nothing is written.
        record: called with each answer as the predictor gave it, valid or not, in the calling
            thread, while nothing is predicted; None = nothing is recorded.
        on_record: called with each record when its frame is done.
        stop: called before each frame; True ends the stream.

    Raises:
        Exception: what `write` and `record` raise ends the stream.
    """
    reads: deque[tuple[int, str, Future[TimedFrame]]] = deque()
    writes: deque[tuple[FrameRecord, Future[float] | None]] = deque()
    records: list[FrameRecord] = []
    waiting = iter(enumerate(frames))
    health, jitter = FrameHealth(), Jitter()

    def read_checked(listed: ListedFrame) -> TimedFrame:
        frame, read_ms = reader.take(listed)
        scale = predictor.camera_scale((frame.rgb.shape[0], frame.rgb.shape[1]))
        found = health.check(frame.rgb, frame.sparse_depth, range_m=scale.range_m)
        return replace(frame, health=found), read_ms

    def read_next() -> None:
        for index, listed in waiting:
            reads.append((index, listed.name, reading_thread.submit(read_checked, listed)))
            return

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
            done, answered = answer_frame(predictor, index, name, reading.result)
            written = None
            if answered is not None:
                frame, prediction = answered
                if due is not None:
                    age_ms = (time.perf_counter() - due) * 1e3
                    jitter_ms = jitter.record(round(age_ms * NS_PER_MS))
                    done = replace(done, age_ms=age_ms, jitter_ms=jitter_ms)
                if record is not None:
                    record(frame, prediction)
                if reasons := frame.degraded + degraded:
                    prediction = replace(prediction, degraded=prediction.degraded + reasons)
                    done = replace(done, degraded=prediction.degraded)
                if write is not None and prediction.valid:
                    written = writer.submit(_timed_write, write, frame, prediction)
            writes.append((done, written))
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
    if sys.platform == "linux":  # elsewhere nice() is of the whole process
        os.nice(_NICENESS)


def _timed_write(write: WriteFrame, frame: Frame, prediction: Prediction) -> float:
    started = time.perf_counter()
    write(frame, prediction)
    return (time.perf_counter() - started) * 1e3
