"""The matching of recorded messages: every image, in the order of the stamps, without a clock.

An image without a partner waits until the depth stamps are the skew plus `_MAX_WAIT_NS` ahead, an
image with a partner until the match is certain. So the pairs do not depend on how far one sensor
was recorded behind the other, unless too many messages wait.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial

from runtime.checks import check_number
from runtime.errors import InputError
from runtime.sync.matching import Decided, Matching, Message, Pair
from runtime.sync.outcome import Outcome, Sensor
from runtime.sync.stamp import NS_PER_MS

_MAX_WAIT_NS = 50 * NS_PER_MS  # by stamps: how far a sensor's messages may be out of order
_check_ms = partial(check_number, least=0, most=1e6, unit="milliseconds", error=InputError)


def match_by_stamp(
    messages: Iterable[tuple[Sensor, Message]],
    *,
    max_skew_ms: float,
    reuse_depth_ms: float,
    waiting: int,
    on_decided: Callable[[Decided], object],
) -> Iterator[Pair]:
    """Return an iterator over each image with its depth map or None, by the images' stamps.

    Args:
        messages: in the order of the recording.
        max_skew_ms: largest difference between the stamps of a pair.
        reuse_depth_ms: largest age of a depth map that an image without one of its own takes.
        waiting: most messages of a sensor that wait. More wait only if the sensor is far ahead of
            the other sensor, or the other sensor is silent.
        on_decided: called with the outcomes of each step.

    Raises:
        InputError: if the skew or the age is out of range.
    """
    matching = StampMatching(
        max_skew_ns=round(_check_ms("max_skew_ms", max_skew_ms) * NS_PER_MS),
        reuse_ns=round(_check_ms("reuse_depth_ms", reuse_depth_ms) * NS_PER_MS),
        capacity=waiting,
    )

    def steps() -> Iterator[Decided]:
        for sensor, message in messages:
            yield matching.add(sensor, message)
        yield matching.flush()

    def pairs() -> Iterator[Pair]:
        for decided in steps():
            on_decided(decided)
            yield from decided.pairs

    return pairs()


class StampMatching(Matching):
    """Matches messages in the order of a recording."""

    def add(self, sensor: Sensor, message: Message) -> Decided:
        """Take the next message, and decide what is certain with it."""
        decided = Decided()
        waiting = self._sensors[sensor].messages
        if len(waiting) >= self._capacity:
            if sensor is Sensor.IMAGE:
                self._decide_image(decided, waiting[0])
            else:
                self._discard_depth(decided, waiting[0], Outcome.NO_IMAGE)
            self._decide(decided)
        if self._admit(decided, sensor, message):
            self._decide(decided)
        return decided

    def _next_decidable(self) -> Message | None:
        """The oldest image, if no later message can change its answer."""
        for oldest in self._images[:1]:
            depth = self._partner(oldest)
            # An image with a partner waits for the images that might be nearer to it.
            if depth is None:
                is_final = self._is_over(oldest, Sensor.DEPTH)
            else:
                is_final = self._is_certain(oldest, depth)
            return oldest if is_final else None
        return None

    def _is_over(self, message: Message, other: Sensor) -> bool:
        newest_ns = self._sensors[other].intervals.newest_ns
        over_ns = message.stamp_ns + self._max_skew_ns + _MAX_WAIT_NS
        return newest_ns is not None and newest_ns > over_ns

    def _next_ns(self, sensor: Sensor) -> int:
        newest_ns = self._sensors[sensor].intervals.newest_ns
        assert newest_ns is not None
        return newest_ns

    def _decide_images(self, decided: Decided) -> None:
        while self._images:
            self._decide_image(decided, self._images[0])
