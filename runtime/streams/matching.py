"""Matching of images and depth maps by the sensors' own stamps.

This module uses no threads, clocks or arrays. An image is matched with the depth map nearest to it
within `max_skew_ns`, a depth map with the image nearest to it. A match is certain once no later
message can be nearer; the stamps of a sensor are assumed to rise. An image without a partner takes
the newest depth map before it that is at most `reuse_ns` old ("reused"). One depth map may serve
several images, beside the one that it was matched with.

Live streams and recordings differ in how long a message waits for its partner: `LiveMatcher` has
the rules of a live stream, `RecordingMatcher` those of a recording.
"""

from abc import ABC, abstractmethod
from bisect import insort
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from statistics import median_low
from typing import Generic, NamedTuple, TypeVar

from runtime.base.arguments import check_number
from runtime.base.errors import InputError
from runtime.base.stamp import JUMP_BACK_NS, NS_PER_MS
from runtime.geometry.rig import Rig
from runtime.streams.messages import MATCHED, Message, Outcome, Place, Sensor

_REMEMBERED_STAMPS = 64  # latest of a sensor, to detect duplicates
_REMEMBERED_INTERVALS = 16
_KNOWN_INTERVALS = 5  # from which the period is known
_stamp_of = attrgetter("time_ns")
_MAX_WAIT_NS = 50 * NS_PER_MS  # of a recording: how far a sensor's messages may be out of order


M = TypeVar("M", bound=Message | Place)


class Discarded(NamedTuple, Generic[M]):
    """A message that will not be answered."""

    message: M
    outcome: Outcome


class Pair(NamedTuple, Generic[M]):
    """An image and the depth that belongs to it.

    Attributes:
        image: the image.
        depth: its depth; None: there is none.
        reused: whether the depth is an older message, whose outcome is counted elsewhere.
    """

    image: M
    depth: M | None = None
    reused: bool = False

    @property
    def own_depth(self) -> M | None:
        """The depth that shares the outcome of the image; None if the depth is reused."""
        return None if self.reused else self.depth


@dataclass
class Decided(Generic[M]):
    """What one step decided.

    Attributes:
        pairs: in the order of their images.
        discarded: messages that are in none of these pairs.
        jumped_back: whether the message of the step was older than the newest of its sensor by more
            than a second.
    """

    pairs: list[Pair[M]] = field(default_factory=list)
    discarded: list[Discarded[M]] = field(default_factory=list)
    jumped_back: bool = False


class Intervals:
    """The latest intervals of a sensor; they start anew where its stamps jump back.

    Attributes:
        newest_ns: the newest stamp; None before the first one.
    """

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self._intervals: deque[int] = deque(maxlen=_REMEMBERED_INTERVALS)

    def add(self, stamp_ns: int) -> None:
        """Add the stamp of a message; stamps may come in any order."""
        newest_ns = self.newest_ns
        if newest_ns is None or stamp_ns < newest_ns - JUMP_BACK_NS:
            self._intervals.clear()
        elif stamp_ns > newest_ns:
            self._intervals.append(stamp_ns - newest_ns)
        else:
            return
        self.newest_ns = stamp_ns

    @property
    def shortest_ns(self) -> int:
        """The shortest interval; 0 before the first one."""
        return min(self._intervals, default=0)

    def period_ns(self) -> int | None:
        """The median interval; None before `_KNOWN_INTERVALS` intervals."""
        return median_low(self._intervals) if len(self._intervals) >= _KNOWN_INTERVALS else None

    def spread_ns(self, period_ns: int) -> int:
        """Mean distance from the period of the intervals that are one period long."""
        single = [each for each in self._intervals if each < 1.5 * period_ns]
        return sum(abs(each - period_ns) for each in single) // len(single)


class Matcher(ABC, Generic[M]):
    """Holds messages that wait for a partner.

    Args:
        rig: says which stamps belong together, and how old depth may be that is reused.
        capacity: largest number of waiting messages of a sensor.
    """

    def __init__(self, rig: Rig, capacity: int) -> None:
        self._max_skew_ns = round(rig.max_skew_ms * NS_PER_MS)
        self._reuse_ns = round(rig.max_depth_age_ms * NS_PER_MS)
        self._capacity = capacity
        # Depth maps that may be reused, and their outcome when dropped; None: already counted.
        self._kept: dict[M, Outcome | None] = {}
        self._start()

    def flush(self) -> Decided[M]:
        """Decide all waiting messages at the end of the stream."""
        decided = Decided[M]()
        self._flush(decided, Outcome.NO_IMAGE)
        return decided

    # --- the rules of a live stream and of a recording -------------------------------------------

    # Whether the next message of a sensor comes no sooner than after its shortest interval.
    _is_regular = False

    @abstractmethod
    def _next_decidable(self) -> M | None:
        """Return the image to decide next; None if all images have to wait."""

    @abstractmethod
    def _is_over(self, message: M, other: Sensor) -> bool:
        """Whether a message has waited long enough for the `other` sensor."""

    @abstractmethod
    def _decide_images(self, decided: Decided[M]) -> None:
        """Decide all images that wait, at the end of the stream."""

    # --- deciding --------------------------------------------------------------------------------

    def _start(self) -> None:
        """Begin without stamps, at first and after the stamps jumped back."""
        self._images: list[M] = []  # those that wait, by stamp
        self._depths: list[M] = []
        self._intervals = {sensor: Intervals() for sensor in MATCHED}
        self._remembered = {sensor: deque[int](maxlen=_REMEMBERED_STAMPS) for sensor in MATCHED}
        self._decided_ns: int | None = None  # the newest image that was decided

    def _waiting(self, sensor: Sensor) -> list[M]:
        return self._images if sensor is Sensor.IMAGE else self._depths

    def _admit(self, decided: Decided[M], message: M) -> bool:
        """Let a message wait, unless it is discarded at once."""
        sensor, time_ns = message.sensor, message.time_ns
        if time_ns in self._remembered[sensor]:
            decided.discarded.append(Discarded(message, Outcome.DUPLICATE))
            return False
        newest_ns = self._intervals[sensor].newest_ns
        if newest_ns is not None and time_ns < newest_ns - JUMP_BACK_NS:
            decided.jumped_back = True
            self._flush(decided, Outcome.CLOCK_JUMP)
            self._start()
        decided_ns = self._decided_ns
        if sensor is Sensor.IMAGE and decided_ns is not None and time_ns <= decided_ns:
            decided.discarded.append(Discarded(message, Outcome.LATE))
            return False
        insort(self._waiting(sensor), message, key=_stamp_of)
        self._remembered[sensor].append(time_ns)
        self._intervals[sensor].add(time_ns)
        return True

    def _decide(self, decided: Decided[M]) -> None:
        """Decide all messages that need not wait any longer."""
        while (image := self._next_decidable()) is not None:
            self._decide_image(decided, image)
        for depth in list(self._depths):
            if self._is_over(depth, Sensor.IMAGE) and not self._near(depth):
                self._keep(decided, depth, Outcome.NO_IMAGE)

    def _decide_image(self, decided: Decided[M], image: M) -> None:
        """Make the frame of an image; older images that still wait are overtaken."""
        partner = self._partner(image)
        depth = self._older_depth(image) if partner is None else partner
        self._decided_ns = image.time_ns
        place = self._images.index(image)
        decided.discarded += [Discarded(each, Outcome.OVERTAKEN) for each in self._images[:place]]
        del self._images[: place + 1]
        decided.pairs.append(Pair(image, depth, depth is not partner))
        if partner is not None:
            self._keep(decided, partner, None)
        elif depth in self._depths:  # later images are farther away in time
            self._keep(decided, depth, Outcome.REUSED)
        elif depth is not None and self._kept[depth] is not None:
            self._kept[depth] = Outcome.REUSED
        for dead in list(self._depths):
            if dead.time_ns < image.time_ns - self._max_skew_ns:  # too old for later images, too
                self._keep(decided, dead, Outcome.NO_IMAGE)
        self._forget_depths(decided, image.time_ns)

    def _flush(self, decided: Decided[M], outcome: Outcome) -> None:
        self._decide_images(decided)
        decided.discarded += [Discarded(depth, outcome) for depth in self._depths]
        self._depths.clear()
        self._drop(decided, self._kept)

    def _partner(self, image: M) -> M | None:
        """The nearest depth map that has no nearer image; ties keep the older."""
        candidates = (
            depth
            for depth in self._depths
            if _distance(image, depth) <= self._max_skew_ns
            and not any(_distance(other, depth) < _distance(image, depth) for other in self._images)
        )
        return min(candidates, key=lambda depth: _distance(image, depth), default=None)

    def _next_ns(self, sensor: Sensor) -> int:
        """The earliest possible next stamp of a sensor; only after its first message."""
        intervals = self._intervals[sensor]
        assert intervals.newest_ns is not None
        return intervals.newest_ns + (intervals.shortest_ns if self._is_regular else 0)

    def _is_certain(self, image: M, depth: M) -> bool:
        """Whether no later message can be nearer in time to either partner."""
        return (
            self._next_ns(Sensor.DEPTH) - image.time_ns >= _distance(image, depth)
            and self._next_ns(Sensor.IMAGE) - depth.time_ns >= depth.time_ns - image.time_ns
        )

    def _near(self, depth: M) -> bool:
        """Whether an image waits that may still be matched with this depth map."""
        return any(_distance(image, depth) <= self._max_skew_ns for image in self._images)

    # --- depth maps that may be reused ------------------------------------------------------------

    def _older_depth(self, image: M) -> M | None:
        """The newest depth map before an image, if it is not too old."""
        if not self._reuse_ns:
            return None
        depths = (*self._kept, *self._depths)
        recent = (depth for depth in depths if 0 <= image.time_ns - depth.time_ns <= self._reuse_ns)
        return max(recent, key=_stamp_of, default=None)

    def _keep(self, decided: Decided[M], depth: M, outcome: Outcome | None) -> None:
        """Keep a depth map that leaves the matching; its outcome follows when it is dropped."""
        self._depths.remove(depth)
        self._kept[depth] = outcome
        by_stamp = sorted(self._kept, key=_stamp_of)
        self._drop(decided, by_stamp[: -self._capacity] if self._reuse_ns else by_stamp)

    def _forget_depths(self, decided: Decided[M], image_ns: int) -> None:
        """Drop depth maps before the image, except the newest: no later image can reuse them."""
        before = sorted((d for d in self._kept if d.time_ns <= image_ns), key=_stamp_of)
        if before and image_ns - before[-1].time_ns < self._reuse_ns:
            before.pop()
        self._drop(decided, before)

    def _drop(self, decided: Decided[M], depths: Iterable[M]) -> None:
        for depth in list(depths):
            if (outcome := self._kept.pop(depth)) is not None:
                decided.discarded.append(Discarded(depth, outcome))


class LiveMatcher(Matcher[Message]):
    """Matches messages as they arrive; deciding an image discards all older images.

    Args:
        rig: see `Matcher`.
        capacity: see `Matcher`.
        max_wait_ms: how long a message waits for its partner.

    Raises:
        InputError: if `max_wait_ms` is out of range.
    """

    _is_regular = True

    def __init__(self, rig: Rig, capacity: int, max_wait_ms: float) -> None:
        super().__init__(rig, capacity)
        check_number("max_wait_ms", max_wait_ms, 0, 1e6, "milliseconds", error=InputError)
        self._max_wait_ns = round(max_wait_ms * NS_PER_MS)
        self._now_ns = 0

    def add(self, message: Message) -> Decided[Message]:
        """Take a message that has just arrived, and decide what is certain with it."""
        decided = Decided[Message]()
        self._now_ns = message.arrived_ns
        if self._admit(decided, message):
            self._decide(decided)
            waiting = self._waiting(message.sensor)
            if len(waiting) > self._capacity:
                decided.discarded.append(Discarded(waiting.pop(0), Outcome.OVERFLOW))
        return decided

    def advance(self, now_ns: int) -> Decided[Message]:
        """Decide what has waited long enough."""
        decided = Decided[Message]()
        self._now_ns = now_ns
        self._decide(decided)
        return decided

    def due_ns(self) -> int | None:
        """Return when to call `advance` next; None: only after another message."""
        # A depth map near a waiting image is decided together with this image.
        waiting = [*self._images, *(depth for depth in self._depths if not self._near(depth))]
        arrived_ns = min((message.arrived_ns for message in waiting), default=None)
        return None if arrived_ns is None else arrived_ns + self._max_wait_ns

    def _next_decidable(self) -> Message | None:
        """The newest of the images that can be decided."""
        for image in reversed(self._images):
            depth = self._partner(image)
            is_certain = depth is not None and self._is_certain(image, depth)
            if is_certain or self._is_over(image, Sensor.DEPTH):
                return image
        # The oldest image, if no depth map is expected for it. A newer image has to wait, because
        # deciding it would discard the oldest.
        oldest = next(iter(self._images), None)
        if oldest is None or self._partner(oldest) is not None or self._is_due(oldest):
            return None
        return oldest

    def _is_due(self, image: Message) -> bool:
        """Whether a depth map may still arrive whose nearest image is this image."""
        depths = self._intervals[Sensor.DEPTH]
        images = self._intervals[Sensor.IMAGE]
        period_ns, image_period_ns = depths.period_ns(), images.period_ns()
        if period_ns is None or image_period_ns is None or depths.newest_ns is None:
            return True
        silent_ns = image.time_ns - depths.newest_ns
        if silent_ns > self._max_wait_ns + 2 * period_ns:
            return False  # a LiDAR that stopped
        # The stamps that are expected next: newest + n * period, n = 1, 2, ...
        slack_ns = depths.spread_ns(period_ns) + images.spread_ns(image_period_ns)
        ahead = max(silent_ns // period_ns, 0)
        return any(
            abs(depths.newest_ns + n * period_ns - image.time_ns)
            <= min(self._max_skew_ns, image_period_ns // 2) + slack_ns
            for n in (ahead, ahead + 1)
            if n > 0
        )

    def _is_over(self, message: Message, other: Sensor) -> bool:
        return self._now_ns - message.arrived_ns >= self._max_wait_ns

    def _decide_images(self, decided: Decided[Message]) -> None:
        complete = [image for image in self._images if self._partner(image) is not None]
        for images in (complete, self._images):
            for newest in images[-1:]:
                self._decide_image(decided, newest)


class RecordingMatcher(Matcher[M]):
    """Matches messages in the order of a recording.

    If `capacity` messages of a sensor wait and another one arrives, the oldest is decided. This
    happens only if the sensor is far ahead of the other one, or the other one is silent.
    """

    def match(self, messages: Iterable[M]) -> Iterator[Decided[M]]:
        """Yield what each of the messages, in the order of the recording, and their end decide.

        The pairs are each image with its depth map or None, in the order of the images' stamps.
        """
        for message in messages:
            yield self.add(message)
        yield self.flush()

    def add(self, message: M) -> Decided[M]:
        """Take the next message, and decide what is certain with it."""
        decided = Decided[M]()
        waiting = self._waiting(message.sensor)
        if len(waiting) >= self._capacity:
            if message.sensor is Sensor.IMAGE:
                self._decide_image(decided, waiting[0])
            else:
                self._keep(decided, waiting[0], Outcome.NO_IMAGE)
            self._decide(decided)
        if self._admit(decided, message):
            self._decide(decided)
        return decided

    def _next_decidable(self) -> M | None:
        """The oldest image, if no later message can change its partner."""
        if not self._images:
            return None
        oldest = self._images[0]
        if (depth := self._partner(oldest)) is None:
            is_over = self._is_over(oldest, Sensor.DEPTH)
        else:  # wait for images that might be nearer to this depth map
            is_over = self._is_certain(oldest, depth)
        return oldest if is_over else None

    def _is_over(self, message: M, other: Sensor) -> bool:
        newest_ns = self._intervals[other].newest_ns
        over_ns = message.time_ns + self._max_skew_ns + _MAX_WAIT_NS
        return newest_ns is not None and newest_ns > over_ns

    def _decide_images(self, decided: Decided[M]) -> None:
        while self._images:
            self._decide_image(decided, self._images[0])


def _distance(one: Message | Place, other: Message | Place) -> int:
    return abs(one.time_ns - other.time_ns)
