"""Match the recorded messages of two sensors by their stamps, as a replay does."""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from runtime.checks import check_number
from runtime.errors import InputError
from runtime.sync.outcome import Sensor
from runtime.sync.stamp import NS_PER_MS
from runtime.sync.synchronizer import Message, Pair, Synchronizer

_MAX_WAIT_NS = 50 * NS_PER_MS  # by stamps: how far a sensor's messages may be out of order
_WAITING = 64  # messages of a sensor; more mean that it is far ahead, or the other one silent


def match_by_stamp(
    messages: Iterable[tuple[Sensor, int, Any]],
    *,
    max_skew_ms: float,
    left_out: Counter[str],
    reuse_depth_ms: float = 0.0,
) -> Iterator[Pair]:
    """Yield each image with its depth map or None, in the order of the images' stamps.

    Args:
        messages: (sensor, stamp in nanoseconds, data) in the order of the recording.
        max_skew_ms: largest difference between the stamps of a pair.
        reuse_depth_ms: largest age of a depth map that an image without one of its own takes.
        left_out: counts each message that is in no pair: "image: duplicate", and so on.

    Raises:
        InputError: if the skew or the age is out of range.
    """
    for name, value in (("max_skew_ms", max_skew_ms), ("reuse_depth_ms", reuse_depth_ms)):
        check_number(name, value, 0, 1e6, "milliseconds", error=InputError)
    synchronizer = Synchronizer(
        live=False,
        max_skew_ns=round(max_skew_ms * NS_PER_MS),
        max_wait_ns=_MAX_WAIT_NS,
        capacity=_WAITING,
        reuse_ns=round(reuse_depth_ms * NS_PER_MS),
    )

    def steps() -> Iterator[Any]:
        for sensor, stamp_ns, data in messages:
            if synchronizer.full(sensor):
                yield synchronizer.release_oldest(sensor, now_ns=0)
            yield synchronizer.add(sensor, Message(stamp_ns, stamp_ns, 0, data), now_ns=0)
        yield synchronizer.flush()

    for decided in steps():
        left_out.update(f"{gone.sensor}: {gone.outcome}" for gone in decided.discarded)
        yield from decided.pairs


def left_out_note(left_out: Counter[str]) -> tuple[str, ...]:
    """A line for people about the messages that are in no frame; none if there are none."""
    if not left_out:
        return ()
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(left_out.items()))
    return (f"left out: {counts}",)
