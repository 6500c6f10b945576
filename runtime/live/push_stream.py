"""A stream that is pushed into: images and depth maps in from any thread, answers out.

One worker thread predicts. All state is guarded by one lock. Who waits for an answer waits for
`_answered`, so that he is not woken in vain beside a prediction; all others wait for `_changed`,
which is notified at each other change. What always holds:

1. A message that was accepted is in one place: with the synchronizer, in `_ready`, with the worker
   (`_take` to `_answer`), or its outcome is counted. Whoever moves it holds the lock.
2. The lock is not held while predicting, copying or calling a callback: so who pushes into a live
   stream waits for a few comparisons at most, and a callback may call anything here.
3. Live, `_ready` and `_results` hold one item at most and the synchronizer `_WAITING` a sensor;
   replayed, a push waits while there are as many as that.
4. In a replay a push waits for room alone. The worker makes room as long as there is something to
   decide or to predict and room for its answer; where all waits for a message that who pushes is
   kept from pushing, the worker decides the oldest one `max_wait_ms` after anything last
   moved.
5. `closed` never becomes False again. Once it is True nothing is accepted, nobody waits for room,
   and the worker ends after what was accepted, which is bounded by 3.
"""

import threading
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InferenceError, InputError, SSDNetError
from runtime.io.calibration import Calibration
from runtime.live.answerer import Answer, Answerer, AnswersFrames
from runtime.live.clock import MonotonicClock
from runtime.live.frame_result import FrameResult
from runtime.live.message_counter import MessageCounter, StreamCounts
from runtime.live.payload import check_depth, check_points
from runtime.live.stream_statistics import StatisticsRecorder, StreamStatistics
from runtime.live.watchdog import Watchdog, WatchdogLimits, WatchdogState
from runtime.preprocess import check_rgb
from runtime.sync.outcome import Outcome, Sensor
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS, NS_PER_MS, Stamp, stamp_ns
from runtime.sync.synchronizer import Decided, Message, Pair, Synchronizer

LIVE, REPLAY = "live", "replay"
_WAITING = 16  # messages a sensor that wait for their partner
_READY = 2  # replay: pairs that wait for their turn
_RESULTS = 8  # replay: answers that wait to be fetched
_LONGEST_MS = 1e9
_END = object()


class PushStream:
    """Match, predict and account for what sensors push from their own threads.

    ```python
    with PushStream(predictor, mode="live", deadline_ms=50) as stream:
        stream.push_image(rgb, stamp)  # in the camera's callback; seconds, or int nanoseconds
        stream.push_depth(sparse_depth, stamp)  # in the LiDAR's; or push_points(points, stamp)
        for result in stream:  # ends after stream.close()
            result.prediction, result.skew_ms, result.age_ms, result.deadline_met
    stream.counts, stream.statistics  # the outcome of every message; latency, age, jitter
    ```

    All methods may be called from any thread. Results are fetched by iterating, which ends after
    `close()`, or passed to `on_result`.

    Args:
        predictor: a `Predictor`, or a drop-in replacement; it must outlive the stream.
        mode: "live": a push never waits, and the newest complete frame wins. "replay": every frame
            is answered, in the order of the stamps, and a push waits until there is room.
        deadline_ms: limit for `FrameResult.latency_ms`; None = no limit.
        max_skew_ms: largest difference between the stamps of an image and its depth map.
        max_wait_ms: how long an image waits for its depth map before it is answered from the
            camera alone, and a depth map for its image. Live by the clock, in a replay by the
            stamps.
        calibration: of camera and LiDAR, required by `push_points`; its focal length is used where
            the predictor has none.
        consistency: share of the returns that is held out of each frame to check whether camera
            and LiDAR are still calibrated and in sync (0.05, for example); every 10th frame then
            takes a second prediction. None = no check.
        on_result: called with each `FrameResult` in the stream's thread, instead of iterating.
        on_error: called there with each InputError or InferenceError of a frame.
        on_state: called there with each new `state`.
        watchdog: limits for `state`.
        sensor_clock: returns the present time of the clock that the stamps are of, for
            `FrameResult.age_ms`.
        clock: the clock used for waiting; for tests.

    Attributes:
        mode: as given.
        deadline_ms: as given.

    Raises:
        InputError: if an option is out of range.
    """

    def __init__(
        self,
        predictor: AnswersFrames,
        *,
        mode: str = LIVE,
        deadline_ms: float | None = None,
        max_skew_ms: float = DEFAULT_MAX_SKEW_MS,
        max_wait_ms: float = 50.0,
        calibration: Calibration | None = None,
        consistency: float | None = None,
        on_result: Callable[[FrameResult], object] | None = None,
        on_error: Callable[[SSDNetError], object] | None = None,
        on_state: Callable[[WatchdogState], object] | None = None,
        watchdog: WatchdogLimits | None = None,
        sensor_clock: Callable[[], Stamp] | None = None,
        clock: MonotonicClock | None = None,
    ) -> None:
        if mode not in (LIVE, REPLAY):
            raise InputError(f'mode must be "{LIVE}" or "{REPLAY}", got {mode!r:.40}')
        self.mode = mode
        self.deadline_ms = (
            None if deadline_ms is None else _check_ms("deadline_ms", deadline_ms, least=1e-6)
        )
        self._max_wait_ns = round(_check_ms("max_wait_ms", max_wait_ms) * NS_PER_MS)
        self._calibration = calibration
        self._answerer = Answerer(predictor, calibration, consistency)  # the worker's alone
        self._on_result, self._on_error, self._on_state = on_result, on_error, on_state
        self._sensor_clock = sensor_clock
        self._clock = clock or MonotonicClock()
        self._live = mode == LIVE

        lock = threading.RLock()
        self._changed, self._answered = threading.Condition(lock), threading.Condition(lock)
        self._synchronizer = Synchronizer(
            live=self._live,
            max_skew_ns=round(_check_ms("max_skew_ms", max_skew_ms) * NS_PER_MS),
            max_wait_ns=self._max_wait_ns,
            capacity=_WAITING,
        )
        self._counter = MessageCounter()
        self._recorder = StatisticsRecorder(self.deadline_ms)
        self._watchdog = Watchdog(watchdog or WatchdogLimits(), live=self._live)
        self._told = self._watchdog.state(0)  # the last state that on_state was told
        self._ready: deque[Pair] = deque()
        self._results: deque[FrameResult] = deque()
        self._held: Counter[Sensor] = Counter()  # pushes that wait for the synchronizer's room
        self._moved_ns = self._clock.now_ns()  # the last push, or pair taken
        self._answers = 0
        self._closed = self._ended = False
        self._failure: BaseException | None = None
        self._worker = threading.Thread(target=self._work, name="ssdnet-stream", daemon=True)
        self._worker.start()

    # --- what sensors call ---------------------------------------------------------------------

    def push_image(self, rgb: NDArray[np.uint8], stamp: Stamp) -> None:
        """Push a picture, uint8 (H, W, 3), red first, taken at `stamp`; it is copied.

        stamp: seconds as a float or nanoseconds as an int, of whatever clock, the depth maps' too
        After `close()` it is counted and nothing else.
        Raises InputError for an array or a stamp that cannot be one; that is counted, too.
        """
        self._push(Sensor.IMAGE, check_rgb, rgb, stamp)

    def push_depth(self, sparse_depth: NDArray[np.float32], stamp: Stamp) -> None:
        """Push a sparse depth map, float32 (H, W) [m], of the picture's size; as `push_image`."""
        self._push(Sensor.DEPTH, check_depth, sparse_depth, stamp)

    def push_points(self, points: NDArray[np.float32], stamp: Stamp) -> None:
        """Push a scan, float32 (N, 3) or wider: x, y, z [m] in the LiDAR's frame; as `push_depth`.

        Raises InputError also for a stream without `calibration`.
        """
        check = partial(check_points, calibration=self._calibration)
        self._push(Sensor.DEPTH, check, points, stamp)

    def _push(self, sensor: Sensor, check: Callable[[Any], Any], data: Any, stamp: Any) -> None:
        outcome = Outcome.BAD_STAMP
        try:
            nanoseconds = stamp_ns(stamp)
            outcome = Outcome.BAD_MESSAGE
            data = check(data).copy()  # drivers fill their buffers again
        except InputError:
            with self._changed:
                self._counter.push(sensor)
                self._counter.record(sensor, outcome)
            raise
        with self._changed:
            self._counter.push(sensor)
            if not self._live:
                try:
                    self._wait_for_room(sensor)
                except BaseException:
                    self._counter.record(sensor, Outcome.INTERRUPTED)
                    raise
            if self._closed:
                self._counter.record(sensor, Outcome.CLOSED)
                return
            now_ns = self._moved_ns = self._clock.now_ns()
            self._watchdog.start(now_ns)
            jumps = self._synchronizer.jumps_back
            message = Message(stamp, nanoseconds, now_ns, data)
            self._queue(self._synchronizer.add(sensor, message, now_ns))
            if self._synchronizer.jumps_back != jumps:
                self._recorder.reset_jitter()
            self._changed.notify_all()

    def _wait_for_room(self, sensor: Sensor) -> None:
        if threading.current_thread() is self._worker:  # a callback: nobody else would make room
            return
        while not self._closed:
            full = self._synchronizer.full(sensor)
            if not full and len(self._ready) < _READY:
                return
            self._held[sensor] += full
            self._changed.notify_all()
            try:
                self._clock.wait(self._changed, None)
            finally:
                self._held[sensor] -= full

    # --- what the stack calls ------------------------------------------------------------------

    @property
    def counts(self) -> StreamCounts:
        """What became of everything that was pushed so far."""
        with self._changed:
            return self._counter.counts(
                out_of_order=self._synchronizer.out_of_order,
                jumps_back=self._synchronizer.jumps_back,
            )

    @property
    def statistics(self) -> StreamStatistics:
        """Latency, age, skew, jitter and missed deadlines of all answers so far."""
        with self._changed:
            return self._recorder.statistics()

    @property
    def state(self) -> WatchdogState:
        """How the stream is doing at this moment, also where a prediction never comes back."""
        with self._changed:
            return self._watchdog.state(self._clock.now_ns())

    def close(self) -> None:
        """Accept nothing more, answer what was accepted, and end.

        What waits for a partner is decided with what is there. Returns when the worker has ended,
        but for the answers that nobody has fetched yet; at once where `on_result` calls it. May be
        called again and from any thread. Raises what `on_result` or `on_error` raised, once.
        """
        with self._changed:
            if not self._closed:
                self._closed = True
                self._queue(self._synchronizer.flush())
                self._changed.notify_all()
        if threading.current_thread() is not self._worker:
            self._worker.join()
            self._raise_failure()

    def __enter__(self) -> "PushStream":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except BaseException:
            if error is None:  # the error that ends the block comes first
                raise

    def __iter__(self) -> "PushStream":
        if self._on_result is not None:
            raise InputError("answers go to on_result: iterate over a stream without it")
        return self

    def __next__(self) -> FrameResult:
        """Wait for the next answer. StopIteration after the last one of a closed stream."""
        with self._changed:
            while not self._results and not self._ended:
                self._clock.wait(self._answered, None)
            if self._results:
                result = self._results.popleft()
                self._changed.notify_all()
                return result
        self._raise_failure()
        raise StopIteration

    def _raise_failure(self) -> None:
        with self._changed:
            failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    # --- the worker ----------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            while (pair := self._take()) is not _END:
                if pair is not None:
                    self._answer(pair)
                self._tell_state()
        except BaseException as failure:  # a callback's: handed on to who closes or iterates
            with self._changed:
                self._failure = failure
                self._closed = True
                self._queue(self._synchronizer.flush())
                while self._ready:
                    self._record_outcome(self._ready.popleft(), Outcome.CLOSED)
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()  # after a failure: who waits for room
                self._answered.notify_all()

    def _take(self) -> Any:
        """Wait for the next pair; None = the state has changed; _END = closed and all done."""
        with self._changed:
            while True:
                now_ns = self._clock.now_ns()
                if not self._closed:
                    self._queue(self._synchronizer.advance(now_ns))
                room = self._live or self._closed or len(self._results) < _RESULTS
                if self._ready and room:
                    self._moved_ns = now_ns
                    self._changed.notify_all()
                    return self._ready.popleft()
                if self._closed and not self._ready:
                    return _END
                if self._watchdog.state(now_ns) != self._told and self._on_state is not None:
                    return None
                due_ns = _earliest(self._synchronizer.due_ns(), self._watchdog.due_ns(now_ns))
                held = [sensor for sensor in Sensor if self._held[sensor]]
                if held and not self._ready:
                    release_ns = self._moved_ns + self._max_wait_ns
                    due_ns = _earliest(due_ns, release_ns)
                    if now_ns >= release_ns:
                        self._moved_ns = now_ns
                        self._queue(self._synchronizer.release_oldest(held[0], now_ns))
                        self._changed.notify_all()
                        continue
                self._clock.wait(self._changed, None if due_ns is None else due_ns - now_ns)

    def _answer(self, pair: Pair) -> None:
        """Predict, settle what the pair has become, and tell."""
        started_ns = self._clock.now_ns()
        try:
            answer = self._answerer.answer(pair)
            now_ns = self._clock.now_ns()
            result = self._result(pair, answer, started_ns, now_ns)
        except SSDNetError as error:
            with self._changed:
                failed = isinstance(error, InferenceError)
                outcome = Outcome.INFERENCE_ERROR if failed else Outcome.INPUT_ERROR
                self._record_outcome(pair, outcome)
                self._watchdog.failed()
            if self._on_error is not None:
                self._on_error(error)
            return
        except BaseException:
            with self._changed:
                self._record_outcome(pair, Outcome.INFERENCE_ERROR)
            raise
        with self._changed:
            self._answers += 1
            self._record(pair, result, now_ns)
            self._record_outcome(pair, Outcome.ANSWERED)
            if self._on_result is None:
                if self._live and self._results:
                    unread = self._results.popleft()
                    self._counter.record_unread(with_depth=unread.depth_stamp is not None)
                self._results.append(result)
                self._answered.notify_all()
        if self._on_result is not None:
            self._on_result(result)

    def _tell_state(self) -> None:
        if self._on_state is None:
            return
        state = self.state
        if state != self._told:
            self._told = state
            self._on_state(state)

    def _result(self, pair: Pair, answer: Answer, started_ns: int, now_ns: int) -> FrameResult:
        image, depth = pair
        latency_ms = (now_ns - (image.arrived_ns if self._live else started_ns)) / NS_PER_MS
        age_ms = None
        if self._sensor_clock is not None:
            age_ms = (stamp_ns(self._sensor_clock()) - image.stamp_ns) / NS_PER_MS
        elif self._live:
            age_ms = latency_ms
        return FrameResult(
            sequence=self._answers,
            rgb=image.data,
            prediction=answer.prediction,
            health=answer.health,
            consistency=answer.consistency,
            image_stamp=image.stamp,
            depth_stamp=None if depth is None else depth.stamp,
            skew_ms=None if depth is None else (depth.stamp_ns - image.stamp_ns) / NS_PER_MS,
            latency_ms=latency_ms,
            age_ms=age_ms,
            deadline_met=None if self.deadline_ms is None else latency_ms <= self.deadline_ms,
        )

    # --- with the lock held --------------------------------------------------------------------

    def _queue(self, decided: Decided) -> None:
        """Count what was discarded and queue the pairs; live, the newest complete one stays."""
        for discarded in decided.discarded:
            self._counter.record(discarded.sensor, discarded.outcome)
        for pair in decided.pairs:
            if self._live and self._ready:
                if self._ready[0].depth is not None and pair.depth is None:
                    self._record_outcome(pair, Outcome.INCOMPLETE)
                    continue
                self._record_outcome(self._ready.popleft(), Outcome.OVERTAKEN)
            self._ready.append(pair)

    def _record_outcome(self, pair: Pair, outcome: Outcome) -> None:
        self._counter.record_frame(outcome, with_depth=pair.depth is not None)

    def _record(self, pair: Pair, result: FrameResult, now_ns: int) -> None:
        latency = result.prediction.latency
        figures_ms = {
            "preprocess": latency.preprocess_ms,
            "inference": latency.inference_ms,
            "postprocess": latency.postprocess_ms,
            "predict": latency.total_ms,
            "latency": result.latency_ms,
            "age": result.age_ms,
            "skew": None if result.skew_ms is None else abs(result.skew_ms),
        }
        self._recorder.record(
            figures_ms,
            transit_ns=now_ns - pair.image.stamp_ns,
            deadline_met=result.deadline_met,
        )
        self._watchdog.answered(
            now_ns,
            late=result.deadline_met is False,
            degraded=bool(result.prediction.degraded or result.health),
            valid=result.prediction.valid,
        )


def _earliest(*times_ns: int | None) -> int | None:
    return min((time_ns for time_ns in times_ns if time_ns is not None), default=None)


def _check_ms(name: str, value: Any, *, least: float = 0.0) -> float:
    number = value if isinstance(value, int | float | np.number) else None
    if isinstance(value, bool) or number is None or not least <= number <= _LONGEST_MS:
        raise InputError(
            f"{name} must be a number of milliseconds from {least:g} to {_LONGEST_MS:g}, got "
            f"{value!r:.40}"
        )
    return float(number)
