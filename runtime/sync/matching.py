"""Which image and which depth map belong together, by the sensors' own stamps.

There are no threads, clocks or arrays here. An image is matched with the depth map nearest to it
within `max_skew_ns`, a depth map with the image nearest to it. A match is certain once no later
message can be nearer; the stamps of a sensor are assumed to rise. An image without a partner takes
the newest depth map before it that is at most `reuse_ns` old ("reused"). One depth map may serve
several images, beside the one that it was matched with.

What differs is how long a message waits for its partner: `synchronizer.py` has the rules of a live
stream, `stamp_matching.py` those of a recording.
"""

from abc import ABC, abstractmethod
from bisect import insort
from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from runtime.sync.intervals import Intervals
from runtime.sync.outcome import MATCHED, Outcome, Sensor
from runtime.sync.stamp import JUMP_BACK_NS, Stamp

_REMEMBERED = 64  # latest stamps of a sensor, to detect duplicates


@dataclass(frozen=True, eq=False)
class Message:
    """An image or a depth map.

    stamp: as given; arrived_ns: by the clock of a live stream.
    """

    stamp: Stamp
    stamp_ns: int
    data: Any = None
    arrived_ns: int = 0


class Pair(NamedTuple):
    """An image and its depth map; None = none was near enough in time.

    reused: the depth map is an older one, which is accounted for elsewhere.
    """

    image: Message
    depth: Message | None
    reused: bool = False

    @property
    def own_depth(self) -> Message | None:
        """The depth map that has the same outcome as the image."""
        return None if self.reused else self.depth


class Discarded(NamedTuple):
    """A message that will not be answered."""

    sensor: Sensor
    message: Message
    outcome: Outcome


@dataclass
class Decided:
    """What one step decided.

    pairs: in the order of their images. out_of_order, jumped_back: whether the message of the step
    was older than the newest of its sensor, and by more than a second.
    """

    pairs: list[Pair] = field(default_factory=list)
    discarded: list[Discarded] = field(default_factory=list)
    out_of_order: bool = False
    jumped_back: bool = False


@dataclass(eq=False)
class _Kept:
    """A depth map that may be reused. outcome: counted on dropping; None = counted before."""

    depth: Message
    outcome: Outcome | None


class _Waiting:
    """Waiting messages of one sensor, and its recent intervals."""

    def __init__(self) -> None:
        self.messages: list[Message] = []  # by stamp
        self.remembered: deque[int] = deque(maxlen=_REMEMBERED)
        self.intervals = Intervals()

    def add(self, message: Message) -> None:
        insort(self.messages, message, key=lambda item: item.stamp_ns)
        self.remembered.append(message.stamp_ns)
        self.intervals.add(message.stamp_ns)


class Matching(ABC):
    """Holds messages that wait for a partner, at most `capacity` of each sensor.

    reuse_ns: largest age of a depth map that an image without one of its own takes; 0 = none.
    """

    def __init__(self, *, max_skew_ns: int, reuse_ns: int, capacity: int) -> None:
        self._max_skew_ns, self._reuse_ns, self._capacity = max_skew_ns, reuse_ns, capacity
        self._sensors = {sensor: _Waiting() for sensor in MATCHED}
        self._kept: list[_Kept] = []  # by stamp
        self._decided_ns: int | None = None  # the newest image that was decided

    def flush(self) -> Decided:
        """Decide all waiting messages at the end of the stream."""
        decided = Decided()
        self._flush(decided, Outcome.NO_IMAGE)
        return decided

    # --- the rules of a live stream and of a recording -------------------------------------------

    @abstractmethod
    def _next_decidable(self) -> Message | None:
        """The image to decide next; None = all wait on."""

    @abstractmethod
    def _is_over(self, message: Message, other: Sensor) -> bool:
        """Whether a message has waited long enough for the `other` sensor."""

    @abstractmethod
    def _next_ns(self, sensor: Sensor) -> int:
        """The earliest possible next stamp of a sensor; only after its first message."""

    @abstractmethod
    def _decide_images(self, decided: Decided) -> None:
        """Decide all images with what is there."""

    # --- deciding --------------------------------------------------------------------------------

    @property
    def _images(self) -> list[Message]:
        return self._sensors[Sensor.IMAGE].messages

    @property
    def _depths(self) -> list[Message]:
        return self._sensors[Sensor.DEPTH].messages

    def _admit(self, decided: Decided, sensor: Sensor, message: Message) -> bool:
        """Let a message wait, unless it is discarded at once."""
        waiting = self._sensors[sensor]
        if message.stamp_ns in waiting.remembered:
            decided.discarded.append(Discarded(sensor, message, Outcome.DUPLICATE))
            return False
        newest_ns = waiting.intervals.newest_ns
        if newest_ns is not None and message.stamp_ns < newest_ns:
            decided.out_of_order = True
            if message.stamp_ns < newest_ns - JUMP_BACK_NS:
                decided.jumped_back = True
                self._flush(decided, Outcome.CLOCK_JUMP)
                self._sensors = {each: _Waiting() for each in MATCHED}
                self._decided_ns = None
        decided_ns = self._decided_ns
        if sensor is Sensor.IMAGE and decided_ns is not None and message.stamp_ns <= decided_ns:
            decided.discarded.append(Discarded(sensor, message, Outcome.LATE))
            return False
        self._sensors[sensor].add(message)
        return True

    def _decide(self, decided: Decided) -> None:
        """Decide what does not wait on."""
        while (image := self._next_decidable()) is not None:
            self._decide_image(decided, image)
        for depth in list(self._depths):
            if self._is_over(depth, Sensor.IMAGE) and not self._near(depth):
                self._discard_depth(decided, depth, Outcome.NO_IMAGE)

    def _decide_image(self, decided: Decided, image: Message) -> None:
        """Make the pair of an image; older images that still wait are overtaken."""
        depth = self._partner(image)
        older_depth = self._older_depth(image) if depth is None else None
        self._decided_ns = image.stamp_ns
        for older in list(self._images):
            if older.stamp_ns < image.stamp_ns:
                self._images.remove(older)
                decided.discarded.append(Discarded(Sensor.IMAGE, older, Outcome.OVERTAKEN))
        self._images.remove(image)
        if depth is not None:
            self._depths.remove(depth)
            self._keep(decided, depth, None)
            decided.pairs.append(Pair(image, depth))
        else:
            decided.pairs.append(Pair(image, older_depth, reused=older_depth is not None))
        if older_depth is not None:
            self._mark_reused(decided, older_depth)
        for dead in list(self._depths):
            if dead.stamp_ns < image.stamp_ns - self._max_skew_ns:  # later images are newer still
                self._discard_depth(decided, dead, Outcome.NO_IMAGE)
        self._forget_depths(decided, image.stamp_ns)

    def _discard_depth(self, decided: Decided, depth: Message, outcome: Outcome) -> None:
        self._depths.remove(depth)
        if outcome is Outcome.NO_IMAGE:
            self._keep(decided, depth, outcome)
        else:
            decided.discarded.append(Discarded(Sensor.DEPTH, depth, outcome))

    def _flush(self, decided: Decided, outcome: Outcome) -> None:
        self._decide_images(decided)
        for depth in list(self._depths):
            self._discard_depth(decided, depth, outcome)
        self._drop(decided, list(self._kept))

    def _partner(self, image: Message) -> Message | None:
        """The nearest depth map that has no nearer image; of two equally near the older."""
        own = (
            depth
            for depth in self._depths
            if _distance(image, depth) <= self._max_skew_ns
            and not any(_distance(other, depth) < _distance(image, depth) for other in self._images)
        )
        return min(own, key=lambda depth: _distance(image, depth), default=None)

    def _is_certain(self, image: Message, depth: Message) -> bool:
        """Whether no later message can be nearer in time to either partner."""
        return (
            self._next_ns(Sensor.DEPTH) - image.stamp_ns >= _distance(image, depth)
            and self._next_ns(Sensor.IMAGE) - depth.stamp_ns >= depth.stamp_ns - image.stamp_ns
        )

    def _near(self, depth: Message) -> bool:
        """Whether an image waits that may still be matched with this depth map."""
        return any(_distance(image, depth) <= self._max_skew_ns for image in self._images)

    # --- depth maps that may be reused ------------------------------------------------------------

    def _older_depth(self, image: Message) -> Message | None:
        """The newest depth map before an image, if it is not too old."""
        if not self._reuse_ns:
            return None
        depths = (*(kept.depth for kept in self._kept), *self._depths)
        recent = (
            depth for depth in depths if 0 <= image.stamp_ns - depth.stamp_ns <= self._reuse_ns
        )
        return max(recent, key=lambda depth: depth.stamp_ns, default=None)

    def _keep(self, decided: Decided, depth: Message, outcome: Outcome | None) -> None:
        """Keep a depth map that left the matching; its outcome follows when it is dropped."""
        insort(self._kept, _Kept(depth, outcome), key=lambda kept: kept.depth.stamp_ns)
        if not self._reuse_ns:
            self._drop(decided, list(self._kept))
        self._drop(decided, self._kept[: -self._capacity])

    def _mark_reused(self, decided: Decided, depth: Message) -> None:
        if depth in self._depths:  # later images are farther away in time
            self._depths.remove(depth)
            self._keep(decided, depth, Outcome.REUSED)
        for kept in self._kept:
            if kept.depth is depth and kept.outcome is not None:
                kept.outcome = Outcome.REUSED

    def _forget_depths(self, decided: Decided, image_ns: int) -> None:
        """Drop depth maps that no later image can reuse: all before the image except the newest."""
        before = [kept for kept in self._kept if kept.depth.stamp_ns <= image_ns]
        if before and image_ns - before[-1].depth.stamp_ns < self._reuse_ns:
            before.pop()
        self._drop(decided, before)

    def _drop(self, decided: Decided, those: list[_Kept]) -> None:
        for kept in those:
            self._kept.remove(kept)
            if kept.outcome is not None:
                decided.discarded.append(Discarded(Sensor.DEPTH, kept.depth, kept.outcome))


def _distance(one: Message, other: Message) -> int:
    return abs(one.stamp_ns - other.stamp_ns)
