"""A stream into which sensors push messages from any thread, and which returns results.

The stream's own thread predicts (`_start_thread`). One lock guards all state: that of `_changed`,
on which all threads wait, and which is notified at every change. Invariants:

1. An accepted message is in one place: in the matcher, in `_ready`, in the frame that is being
   answered, or counted with its outcome. It moves only while the lock is held.
2. The lock is not held during a prediction, a copy or a callback. A push therefore waits for a few
   comparisons at most, and a callback may call any method.
3. Memory is bounded: `_ready` and `_unread` hold one frame each, the matcher `_WAITING`
   messages of a sensor.
4. `_closed` never becomes False again. Once it is True no message is accepted; the thread decides
   the waiting messages, answers the frames that follow, and ends.
5. A frame gets the poses that are known when its answer starts. No image waits for a pose.
"""

import contextlib
import threading
import time
import weakref
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import check_number, shown
from runtime.base.errors import InferenceError, InputError, SSDNetError
from runtime.base.process_guard import ProcessGuard
from runtime.base.stamp import NS_PER_MS, Stamp, stamp_ns
from runtime.geometry.poses import PoseTrack
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.streams.answerer import Answerer, FramePredictor
from runtime.streams.frame_memory import FrameMemory
from runtime.streams.frame_result import FrameResult
from runtime.streams.matching import Decided, LiveMatcher, Pair
from runtime.streams.messages import Message, Outcome
from runtime.streams.sensor_input import Kind, SensorInput
from runtime.streams.statistics import Jitter, StreamStatistics
from runtime.streams.stream_checks import StreamChecks
from runtime.streams.stream_counter import (
    StreamCounter,
    StreamCounts,
    WatchdogLimits,
    WatchdogState,
)

_WAITING = 16  # messages of a sensor that wait for their partner
_EXIT_S = 10.0  # time that the exit of the interpreter waits for a prediction


class MonotonicClock:
    """The clock of a stream, which tests replace: time that never goes back."""

    def now_ns(self) -> int:
        """Nanoseconds since an arbitrary start."""
        return time.monotonic_ns()

    def wait(self, changed: threading.Condition, timeout_ns: int | None) -> None:
        """Wait until `changed`, whose lock is held, is notified; None: without a limit."""
        changed.wait(None if timeout_ns is None else max(timeout_ns, 0) / 1e9)


class PushStream:
    """Match and predict the messages that sensors push from their own threads, and count them.

    A push never waits for a prediction, and the newest complete frame is predicted next. For
    recordings use `replay`.

    ```python
    rig = Rig(calibration=calibration, pose_frame="lidar")
    with PushStream(predictor, rig, deadline_ms=50) as stream:
        stream.push_image(rgb, stamp)  # in the camera's callback; seconds, or int nanoseconds
        stream.push_points(points, stamp)  # in the LiDAR's; or push_depth(sparse_depth, stamp)
        stream.push_pose(pose, stamp)  # in the odometry's
        for result in stream:  # ends after stream.close()
            result.prediction, result.skew_ms, result.age_ms, result.deadline_met
    stream.counts, stream.statistics  # the outcome of every message; latency, age, jitter
    ```

    All methods may be called from any thread of the process that made the stream. Results are
    fetched by iterating, which ends after `close()`, or passed to `on_result`.

    Args:
        predictor: a `Predictor`, or a drop-in replacement; it must outlive the stream.
        rig: the car's sensors: their calibration, what their stamps and poses mean, and which
            messages belong together. `push_points` needs its calibration, `push_pose` its
            `pose_frame`.
        deadline_ms: limit for `FrameResult.latency_ms`; None: no limit.
        max_wait_ms: how long an image waits for its depth map, before it is predicted without
            depth, and how long a depth map waits for its image.
        consistency: share of the returns that is held out of each frame to check whether camera
            and LiDAR are still calibrated and in sync (0.05, for example); every 10th frame is then
            predicted a second time. None: no check.
        check_depth: whether the returns of the first five frames with depth, then of one in a
            hundred when no frame waits, are compared with a prediction from the image alone. Later
            frames then have "implausible_depth" in `Prediction.degraded`. The check runs after the
            frame's result was handed over, and is not part of its latency.
        accept: names of `FrameResult.findings` that are not reported and flag no frame.
        on_result: called with each `FrameResult` in the stream's thread, instead of iterating.
        on_error: called in the stream's thread with each InputError or InferenceError of a frame,
            and with an unexpected error, which ends the stream.
        on_state: called in the stream's thread with each new `state`.
        watchdog: limits for `state`.
        sensor_clock: returns the present time by the clock of the stamps, for
            `FrameResult.age_ms`.
        clock: clock by which the stream waits; only tests replace it.

    Raises:
        InputError: if an option is out of range.
    """

    def __init__(
        self,
        predictor: FramePredictor,
        rig: Rig = DEFAULT_RIG,
        *,
        deadline_ms: float | None = None,
        max_wait_ms: float = 50.0,
        consistency: float | None = None,
        check_depth: bool = True,
        accept: Iterable[str] = (),
        on_result: Callable[[FrameResult], object] | None = None,
        on_error: Callable[[Exception], object] | None = None,
        on_state: Callable[[WatchdogState], object] | None = None,
        watchdog: WatchdogLimits | None = None,
        sensor_clock: Callable[[], Stamp] | None = None,
        clock: MonotonicClock | None = None,
    ) -> None:
        _check_type(WatchdogLimits, watchdog=watchdog)
        _check_type(Callable, on_result=on_result, on_error=on_error, on_state=on_state)
        _check_type(Callable, sensor_clock=sensor_clock)
        if deadline_ms is not None:
            limits = 1e-6, 1e9
            deadline_ms = check_number("deadline_ms", deadline_ms, *limits, "ms", error=InputError)
        # These are used in the stream's thread alone.
        checks = StreamChecks(consistency=consistency, check_depth=check_depth, accept=accept)
        self._on_result, self._on_error, self._on_state = on_result, on_error, on_state
        self._deadline_ms, self._sensor_clock = deadline_ms, sensor_clock
        self._clock = clock or MonotonicClock()

        self._changed = threading.Condition(threading.RLock())
        self._counter, self._jitter = StreamCounter(deadline_ms, watchdog), Jitter()
        self._sensors = SensorInput(rig, counter=self._counter, lock=self._changed)
        self._answerer = Answerer(predictor, checks, memory=FrameMemory.of(rig.memory_s))
        self._matcher = LiveMatcher(rig, _WAITING, max_wait_ms)
        self._reported_state = self._counter.state(0)
        self._ready: Pair[Message] | None = None  # waits for its prediction
        self._unread: tuple[Pair[Message], FrameResult] | None = None  # waits to be fetched
        self._closed = self._ended = self._failure_raised = False
        self._failure: BaseException | None = None
        self._guard = ProcessGuard("PushStream")
        self._thread = _start_thread(self)

    # --- what sensors call ---------------------------------------------------------------------

    def push_image(self, rgb: NDArray[np.uint8], stamp: Stamp) -> None:
        """Push an image; it is copied. After `close()` it is counted and ignored.

        Args:
            rgb: uint8 (H, W, 3), RGB.
            stamp: seconds as a float or nanoseconds as an int, by any clock that all sensors share.

        Raises:
            InputError: if the array or the stamp is not valid, or the image has another size than
                the calibration's; such a message is counted as an error.
            InferenceError: if the stream was ended by an unexpected error.
        """
        self._push("image", rgb, stamp)

    def push_depth(self, sparse_depth: NDArray[np.float32], stamp: Stamp) -> None:
        """Push a sparse depth map, like `push_image`.

        Args:
            sparse_depth: float32 (H, W) of the image's size, metres along the optical axis, 0 = no
                return.
            stamp: see `push_image`.

        Raises:
            InputError: as `push_image`.
            InferenceError: as `push_image`.
        """
        self._push("depth", sparse_depth, stamp)

    def push_points(
        self,
        points: NDArray[np.float32],
        stamp: Stamp,
        times: NDArray[np.floating[Any]] | NDArray[np.integer[Any]] | None = None,
    ) -> None:
        """Push a LiDAR scan, like `push_depth`.

        Args:
            points: float32 (N, 3) or wider: x, y, z in metres in the LiDAR's frame.
            stamp: see `push_image`.
            times: (N,), when each point was measured: floats are seconds after the stamp, integers
                nanoseconds of its clock. None: unknown, see `Rig.scan_stamp`.

        Raises:
            InputError: as `push_image`, and if the rig has no `calibration`, the points cannot be
                metres, or half of the times are more than a second from the stamp.
            InferenceError: as `push_image`.
        """
        self._push("points", points, stamp, times)

    def push_pose(self, pose: NDArray[np.floating[Any]], stamp: Stamp) -> None:
        """Push a pose of the car; stamps must rise, and the rig needs a `pose_frame`.

        Args:
            pose: float (4, 4), rigid, from the rig's `pose_frame` to a frame that is fixed over
                seconds, such as an odometry frame [m].
            stamp: see `push_image`.

        Raises:
            InputError: as `push_image`, if the pose is not rigid or the rig has no `pose_frame`.
            InferenceError: as `push_image`.
        """
        self._push("pose", pose, stamp)

    def _push(self, kind: Kind, data: Any, stamp: Any, times: Any = None) -> None:
        self._guard.check()
        message = self._sensors.check(kind, data, stamp, times)
        with self._changed:
            if self._closed:
                self._counter.push(message.sensor, Outcome.CLOSED)
                if self._failure is not None:
                    raise InferenceError(
                        f"the stream was ended by {shown(self._failure, 200)}: close it and make "
                        "a new one"
                    ) from self._failure
                return
            now_ns = self._clock.now_ns()
            self._counter.record_accepted(message.sensor, now_ns)
            taken = self._sensors.take(replace(message, arrived_ns=now_ns))
            if taken is not None:
                self._queue(self._matcher.add(taken))
            self._changed.notify_all()

    # --- what the stack calls ------------------------------------------------------------------

    @property
    def counts(self) -> StreamCounts:
        """The outcomes of all messages so far."""
        with self._changed:
            return self._counter.counts

    @property
    def statistics(self) -> StreamStatistics:
        """Latency, age, skew, jitter and missed deadlines of all answers so far."""
        with self._changed:
            return self._counter.statistics

    @property
    def state(self) -> WatchdogState:
        """The stream's present state, also while a prediction hangs."""
        with self._changed:
            return self._counter.state(self._clock.now_ns())

    def close(self) -> None:
        """Accept no more messages, answer the accepted ones, and end.

        Messages that wait for a partner are decided without later messages. The method returns when
        the stream's thread has ended; a result that was not fetched can still be fetched. If a
        callback of the stream calls it, it returns at once, and the stream ends by itself. It may
        be called again, and from any thread, but not in a signal handler, which may interrupt
        another method of the stream.

        Raises:
            Exception: the error of a callback, or any other unexpected error of the stream's
                thread; it is raised only once.
        """
        self._guard.check()
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()
            self._raise_failure()

    def __enter__(self) -> "PushStream":
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self.close()
        except BaseException:
            if error[0] is None:  # an error raised in the with block has priority
                raise

    def __iter__(self) -> "PushStream":
        if self._on_result is not None:
            raise InputError("results go to on_result: iterate over a stream without it")
        return self

    def __next__(self) -> FrameResult:
        """Wait for the next result. StopIteration after the last one of a closed stream."""
        self._guard.check()
        with self._changed:
            while self._unread is None and not self._ended:
                self._clock.wait(self._changed, None)
            if self._unread is not None:
                (_, result), self._unread = self._unread, None
                return result
        self._raise_failure()
        raise StopIteration

    def _raise_failure(self) -> None:
        with self._changed:
            raised, self._failure_raised = self._failure_raised, True
        if self._failure is not None and not raised:
            raise self._failure

    # --- the stream's thread -------------------------------------------------------------------

    def _step(self) -> bool:
        """Answer the next frame, if there is one, and report the state; False = the end."""
        with self._changed:
            now_ns = self._clock.now_ns()
            self._queue(self._matcher.flush() if self._closed else self._matcher.advance(now_ns))
            pair, self._ready = self._ready, None
            if pair is None and self._closed:
                self._end()
                return False
            poses = None if pair is None else self._sensors.poses_of(pair)
        if pair is not None:
            self._answer(pair, poses)
            with self._changed:
                idle = self._ready is None
            self._answerer.check_last(idle=idle)
        if self._on_state is not None and (state := self.state) != self._reported_state:
            self._reported_state = state
            self._on_state(state)
        return True

    def _idle_ns(self) -> int | None:
        """Return how long there is no work unless something changes; None: for ever."""
        now_ns = self._clock.now_ns()
        if self._closed or self._ready is not None:
            return 0
        if self._on_state is not None and self._counter.state(now_ns) != self._reported_state:
            return 0
        due_ns = [self._matcher.due_ns(), self._counter.due_ns(now_ns)]
        return min((each - now_ns for each in due_ns if each is not None), default=None)

    def _answer(self, pair: Pair[Message], poses: PoseTrack | None) -> None:
        """Predict, count the pair's outcome, and hand the result over."""
        try:
            _, answer = self._answerer.answer(self._sensors.complete(pair, poses))
            now_ns = self._clock.now_ns()
            result = self._result(pair.image, answer, now_ns)
        except BaseException as error:
            with self._changed:
                self._counter.record_failed(pair, error)
            if not isinstance(error, SSDNetError):
                raise
            if self._on_error is not None:
                self._on_error(error)
            return
        with self._changed:
            self._counter.record_answer(pair, result, now_ns)
            if self._on_result is None:
                if self._unread is not None:
                    self._counter.record_unread(self._unread[0])
                self._unread = pair, result
                self._changed.notify_all()
        if self._on_result is not None:
            self._on_result(result)

    def _result(self, image: Message, answer: FrameResult, now_ns: int) -> FrameResult:
        latency_ms = age_ms = (now_ns - image.arrived_ns) / NS_PER_MS
        if self._sensor_clock is not None:
            age_ms = (stamp_ns(self._sensor_clock()) - image.time_ns) / NS_PER_MS
        with self._changed:
            jitter_ms = self._jitter.record(now_ns - image.time_ns)
        met = None if self._deadline_ms is None else latency_ms <= self._deadline_ms
        return replace(
            answer, latency_ms=latency_ms, age_ms=age_ms, jitter_ms=jitter_ms, deadline_met=met
        )

    def _fail(self, failure: BaseException) -> None:
        """End the stream after an error that is not caused by a frame."""
        with self._changed:
            self._failure = failure
            self._end()
            self._discard_all()
        if self._on_error is not None and isinstance(failure, Exception):
            with contextlib.suppress(Exception):  # on_error itself may be what failed
                self._on_error(failure)

    # --- with the lock held --------------------------------------------------------------------

    def _queue(self, decided: Decided[Message]) -> None:
        """Count what was discarded and make the newest complete pair ready."""
        self._counter.record_discarded(decided.discarded, jumped_back=decided.jumped_back)
        if decided.jumped_back:
            self._jitter.reset()
        for pair in decided.pairs:
            if self._ready is not None and self._ready.depth is not None and pair.depth is None:
                self._counter.record_pair(pair, Outcome.INCOMPLETE)
                continue
            if self._ready is not None:
                self._counter.record_pair(self._ready, Outcome.OVERTAKEN)
            self._ready = pair

    def _discard_all(self) -> None:
        self._closed = True
        self._queue(self._matcher.flush())
        if self._ready is not None:
            self._counter.record_pair(self._ready, Outcome.CLOSED)
            self._ready = None

    def _end(self) -> None:
        self._closed = self._ended = True
        self._changed.notify_all()


def _start_thread(stream: PushStream) -> threading.Thread:
    """Start the thread of a stream, which references the stream only while it works.

    A stream without other references is therefore collected, which ends the thread. The exit of the
    interpreter also ends the thread, because it must not happen during a prediction.
    """
    reference = weakref.ref(stream)
    changed, clock, guard = stream._changed, stream._clock, stream._guard

    def run() -> None:
        while True:
            stream = reference()
            try:
                if stream is None or not stream._step():
                    return
                with changed:
                    idle_ns = stream._idle_ns()
                    stream = None  # collected here, or while this waits
                    if idle_ns != 0 and reference() is not None:
                        clock.wait(changed, idle_ns)
            except BaseException as failure:
                if stream := stream or reference():
                    stream._fail(failure)
                return

    thread = threading.Thread(target=run, name="ssdnet-stream", daemon=True)
    thread.start()

    def end() -> None:
        if guard.is_forked:
            return
        with changed:
            stream = reference()
            if stream is not None:  # at exit
                stream._discard_all()
            changed.notify_all()
        if stream is not None:
            thread.join(_EXIT_S)

    weakref.finalize(stream, end)
    return thread


def _check_type(kind: Any, **values: object) -> None:
    for name, value in values.items():
        if value is not None and not isinstance(value, kind):
            raise InputError(f"{name} must be a {kind.__name__} or None, got {shown(value)}")
