"""Answers to a recording, one after another, without threads or a clock. No image is dropped.

Messages are matched as `ssdnet-run` matches those of a bag. Returns are moved, and answers are
flagged, as in a `PushStream`.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal

from numpy.typing import NDArray

from runtime.base.arguments import shown
from runtime.base.errors import InputError, SSDNetError
from runtime.base.stamp import Stamp
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.streams.answerer import Answerer, FramePredictor
from runtime.streams.frame_memory import FrameMemory
from runtime.streams.frame_result import FrameResult
from runtime.streams.matching import Pair, RecordingMatcher
from runtime.streams.messages import Message
from runtime.streams.sensor_input import SENSORS, Kind, SensorInput
from runtime.streams.stream_checks import StreamChecks
from runtime.streams.stream_counter import StreamCounter

_WAITING = 16  # messages of a sensor that wait for their partner, and frames that wait for poses

# (kind, array, stamp): array and stamp are the arguments of the kind's `PushStream.push_` method.
ReplayMessage = (
    tuple[Kind, NDArray[Any], Stamp]
    | tuple[Literal["points"], NDArray[Any], Stamp, NDArray[Any] | None]
)


def replay(
    predictor: FramePredictor,
    messages: Iterable[ReplayMessage],
    rig: Rig = DEFAULT_RIG,
    *,
    consistency: float | None = None,
    check_depth: bool = True,
    accept: Iterable[str] = (),
    on_error: Callable[[SSDNetError], object] | None = None,
    counter: StreamCounter | None = None,
) -> Iterator[FrameResult]:
    """Answer every image of a recording, like a `PushStream` that is never late.

    ```python
    def messages():  # in the order of time, read as they are needed
        yield "image", rgb, stamp  # seconds, or int nanoseconds
        yield "depth", sparse_depth, stamp  # or "points", points, stamp[, times]
        yield "pose", pose, stamp

    rig = Rig(calibration=calibration, pose_frame="lidar")
    for answer in replay(predictor, messages(), rig):
        answer.prediction, answer.skew_ms, answer.depth_age_ms
    ```

    An image waits for its depth until the stamps of the LiDAR are later than its own, and for poses
    until they reach the image and its scan. If more than 16 images wait, the oldest is answered
    with the messages received so far. One sensor may thus be recorded up to 16 messages later than
    the others.

    Args:
        predictor: a `Predictor`, or a drop-in replacement.
        messages: (kind, array, stamp) of kind "image", "depth", "points" or "pose"; see the method
            of that kind, such as `PushStream.push_image`.
        rig: the car's sensors, see `PushStream`.
        consistency: share of the returns that is held out, see `PushStream`.
        check_depth: whether returns are compared with a prediction from the image alone.
        accept: names of findings that are not reported, see `PushStream`.
        on_error: called with the error of each invalid message and each failed frame, which are
            then left out; None: the first error is raised.
        counter: counts the messages, their outcomes and the answers.

    Returns:
        An iterator over the answers, in the order of the images' stamps.

    Raises:
        InputError: if an option is out of range. The iterator raises it for an object that is no
            message. Without `on_error` it also raises it for a message that `PushStream` refuses,
            and for depth that does not fit its image.
        InferenceError: from the iterator, if the provider fails and there is no `on_error`.
    """
    counter = StreamCounter() if counter is None else counter
    checks = StreamChecks(consistency=consistency, check_depth=check_depth, accept=accept)
    sensors = SensorInput(rig, counter=counter, lock=contextlib.nullcontext())
    answerer = Answerer(predictor, checks, memory=FrameMemory.of(rig.memory_s))

    def report(error: SSDNetError) -> None:
        if on_error is None:
            raise error
        on_error(error)

    def accepted() -> Iterator[Message]:
        """Check the messages, store the poses, and yield the messages to be matched."""
        for message in messages:
            parts = _parts(message)
            try:
                checked = sensors.check(*parts)
            except InputError as error:
                report(error)
                continue
            if (taken := sensors.take(checked)) is not None:
                yield taken

    def answered(pair: Pair[Message]) -> Iterator[FrameResult]:
        """Yield the answer to a pair, or nothing after an error."""
        try:
            _, answer = answerer.answer(sensors.complete(pair, sensors.poses_of(pair)))
        except SSDNetError as error:
            counter.record_failed(pair, error)
            report(error)
            return
        counter.record_answer(pair, answer)
        yield answer
        answerer.check_last(idle=True)

    def answers() -> Iterator[FrameResult]:
        """Answer the pairs as soon as poses reach them."""
        waiting: deque[Pair[Message]] = deque()
        for decided in RecordingMatcher[Message](rig, _WAITING).match(accepted()):
            counter.record_discarded(decided.discarded, jumped_back=decided.jumped_back)
            waiting.extend(decided.pairs)
            while waiting and (len(waiting) > _WAITING or sensors.reaches(waiting[0])):
                yield from answered(waiting.popleft())
        for pair in waiting:
            yield from answered(pair)

    return answers()


def _parts(message: Any) -> tuple[Kind, Any, Any, Any]:
    """Return the kind, array, stamp and times of a message; InputError if it is no message."""
    if isinstance(message, tuple) and len(message) in (3, 4):
        kind, data, stamp, *times = message
        if isinstance(kind, str) and kind in SENSORS and (not times or kind == "points"):
            return kind, data, stamp, times[0] if times else None  # type: ignore[return-value]
    raise InputError(
        f"a message must be a tuple (kind, array, stamp), the kind one of {', '.join(SENSORS)}; "
        f"the times of points may follow; got {shown(message)}"
    )
