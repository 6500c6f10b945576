"""Matching of images and depth maps by the sensors' own stamps.

There are no threads, clocks or arrays here: times are arguments, so that a test can play every
sequence of messages exactly.

An image is matched with the depth map nearest to it within `max_skew_ns`, a depth map with the
image nearest to it. A match is certain once no later message can be nearer: the stamps of a sensor
are assumed to rise, live by at least their shortest recent interval (a learned "inter-message lower
bound" of ROS's approximate time policy), so that a frame of regular sensors does not wait for the
next one. A message whose match is not certain waits. Live: until `max_wait_ns` after it arrived;
then an image is decided with what is there, and a depth map is unmatched. An image that no depth
map is due for, judged by the periods of both sensors, does not wait. In a replay: without a partner
until the other sensor's stamps are `max_skew_ns + max_wait_ns` ahead, with one until it is certain,
and, where poses are pushed, until these reach the image and its scan, so that the pairs do not
depend on the turns of the threads that push.

An image without a partner takes the newest depth map before it that is at most `reuse_ns` old
("reused"). One depth map may serve several images, beside the one that it was matched with.
"""

from bisect import insort
from collections import deque
from dataclasses import dataclass, field
from statistics import median_low
from typing import Any, NamedTuple

from runtime.sync.outcome import MATCHED, Outcome, Sensor

JUMP_BACK_NS = 1_000_000_000  # a sensor's clock was reset if its stamps go back further
_REMEMBERED = 64  # latest stamps of a sensor, to detect duplicates
_INTERVALS = 16  # latest intervals of a sensor; the shortest bounds the next one
_KNOWN = 5  # intervals from which a sensor's period is known


@dataclass(frozen=True, eq=False)
class Message:
    """One push.

    stamp: as pushed; arrived_ns: by the stream's clock. needs_ns: time of the latest pose that it
    is moved by, None = its stamp.
    """

    stamp: Any
    stamp_ns: int
    arrived_ns: int
    data: Any = None
    needs_ns: int | None = None


class Pair(NamedTuple):
    """An image and its depth map; None = none was near enough in time.

    reused: the depth map is an older one, which is accounted for elsewhere.
    """

    image: Message
    depth: Message | None
    reused: bool = False

    @property
    def own_depth(self) -> Message | None:
        """The depth map whose outcome is that of the image."""
        return None if self.reused else self.depth


class Discarded(NamedTuple):
    """A message that will not be answered."""

    sensor: Sensor
    message: Message
    outcome: Outcome


@dataclass(eq=False)
class _Kept:
    """A depth map that may be reused; outcome: when it is dropped, None = it has one."""

    depth: Message
    outcome: Outcome | None


@dataclass
class Decided:
    """The pairs, in the order of their images, and the discarded messages of one step."""

    pairs: list[Pair] = field(default_factory=list)
    discarded: list[Discarded] = field(default_factory=list)


class Synchronizer:
    """Holds messages that wait for a partner, at most `capacity` of each sensor.

    live: an image that is decided discards older ones, and `max_wait_ns` is by the clock. Else
    every image is decided, in the order of the stamps, and `max_wait_ns` is by the stamps.
    reuse_ns: largest age of a depth map that an image without one of its own takes; 0 = none.
    """

    def __init__(
        self,
        *,
        live: bool,
        max_skew_ns: int,
        max_wait_ns: int,
        capacity: int,
        reuse_ns: int = 0,
    ) -> None:
        self._live = live
        self._max_skew_ns, self._max_wait_ns = max_skew_ns, max_wait_ns
        self._capacity, self._reuse_ns = capacity, reuse_ns
        self._sensors = {sensor: _Waiting() for sensor in MATCHED}
        self._kept: list[_Kept] = []  # by stamp
        self._poses_ns: int | None = None  # the newest pose; None = they are not waited for
        self.decided_ns: int | None = None  # the newest image that was decided
        self.out_of_order = 0
        self.jumps_back = 0

    def period_ns(self, sensor: Sensor) -> int | None:
        """The median interval of a sensor; None if it is not known yet."""
        return self._sensors[sensor].period_ns()

    def poses_reach(self, newest_ns: int | None, now_ns: int) -> Decided:
        """In a replay images wait until poses are as new; None = for none."""
        self._poses_ns = newest_ns
        return self.advance(now_ns)

    def full(self, sensor: Sensor) -> bool:
        """Whether another message of `sensor` would be one too many."""
        return len(self._sensors[sensor].messages) >= self._capacity

    def add(self, sensor: Sensor, message: Message, now_ns: int) -> Decided:
        """Take a message, and decide what is certain with it."""
        decided = Decided()
        waiting = self._sensors[sensor]
        if message.stamp_ns in waiting.remembered:
            decided.discarded.append(Discarded(sensor, message, Outcome.DUPLICATE))
            return decided
        if waiting.newest_ns is not None and message.stamp_ns < waiting.newest_ns:
            self.out_of_order += 1
            if message.stamp_ns < waiting.newest_ns - JUMP_BACK_NS:
                self.jumps_back += 1
                self._flush(decided, Outcome.CLOCK_JUMP)
                self._sensors = {sensor: _Waiting() for sensor in MATCHED}
                self.decided_ns = None
                waiting = self._sensors[sensor]
        decided_ns = self.decided_ns
        if sensor is Sensor.IMAGE and decided_ns is not None and message.stamp_ns <= decided_ns:
            decided.discarded.append(Discarded(sensor, message, Outcome.LATE))
            return decided
        waiting.add(message)
        self._decide(decided, now_ns)
        if len(waiting.messages) > self._capacity:  # live; a replay checks `full` first
            oldest = waiting.messages.pop(0)
            decided.discarded.append(Discarded(sensor, oldest, Outcome.OVERFLOW))
        return decided

    def advance(self, now_ns: int) -> Decided:
        """Decide what has waited long enough."""
        decided = Decided()
        self._decide(decided, now_ns)
        return decided

    def due_ns(self) -> int | None:
        """When `advance` will decide something next; None = not without another message."""
        if not self._live:
            return None
        # A depth map near a waiting image is decided with it.
        waiting = [*self._images, *(depth for depth in self._depths if not self._near(depth))]
        arrived_ns = min((message.arrived_ns for message in waiting), default=None)
        return None if arrived_ns is None else arrived_ns + self._max_wait_ns

    def release_oldest(self, sensor: Sensor, now_ns: int) -> Decided:
        """Decide the oldest message of `sensor` with what is there."""
        decided = Decided()
        if self._poses_ns is not None and self._images and self._lacks_poses(self._images[0]):
            self._poses_ns = None  # until the next one
            self._decide(decided, now_ns)
            return decided
        for oldest in self._sensors[sensor].messages[:1]:
            if sensor is Sensor.IMAGE:
                self._decide_image(decided, oldest)
            else:
                self._discard_depth(decided, oldest, Outcome.NO_IMAGE)
        self._decide(decided, now_ns)
        return decided

    def flush(self) -> Decided:
        """Decide everything with what is there, at the end."""
        decided = Decided()
        self._flush(decided, Outcome.NO_IMAGE)
        return decided

    @property
    def _images(self) -> list[Message]:
        return self._sensors[Sensor.IMAGE].messages

    @property
    def _depths(self) -> list[Message]:
        return self._sensors[Sensor.DEPTH].messages

    def _decide(self, decided: Decided, now_ns: int) -> None:
        while (image := self._next_decidable(now_ns)) is not None:
            self._decide_image(decided, image)
        for depth in list(self._depths):
            if self._is_over(depth, Sensor.IMAGE, now_ns) and not self._near(depth):
                self._discard_depth(decided, depth, Outcome.NO_IMAGE)

    def _next_decidable(self, now_ns: int) -> Message | None:
        """The image to decide next: live the newest of those that can be, else only the oldest."""
        oldest = next(iter(self._images), None)
        if not self._live:
            return oldest if oldest is not None and self._is_decidable(oldest, now_ns) else None
        for image in reversed(self._images):
            depth = self._partner(image)
            if depth is not None and self._is_certain(image, depth):
                return image
            if self._is_over(image, Sensor.DEPTH, now_ns):
                return image
        # One that no depth is due for: unless an older one waits, which would be dropped.
        if oldest is None or self._partner(oldest) is not None or self._is_due(oldest):
            return None
        return oldest

    def _is_decidable(self, image: Message, now_ns: int) -> bool:
        """Whether no later message can change the oldest image's answer, in a replay."""
        depth = self._partner(image)
        # An image with a partner waits for the images that might be nearer to it.
        if depth is None:
            certain = self._is_over(image, Sensor.DEPTH, now_ns)
            depth = self._older_depth(image) if certain else None
        else:
            certain = self._is_certain(image, depth)
        return certain and not self._lacks_poses(image, depth)

    def _lacks_poses(self, *messages: Message | None) -> bool:
        """Whether a frame of a replay waits for newer poses."""
        return self._poses_ns is not None and any(
            self._poses_ns < (each.stamp_ns if each.needs_ns is None else each.needs_ns)
            for each in messages
            if each is not None
        )

    def _is_due(self, image: Message) -> bool:
        """Whether a depth map may still come whose nearest image this is."""
        depths, images = self._sensors[Sensor.DEPTH], self._sensors[Sensor.IMAGE]
        period_ns, image_period_ns = depths.period_ns(), images.period_ns()
        if period_ns is None or image_period_ns is None or depths.newest_ns is None:
            return True
        silent_ns = image.stamp_ns - depths.newest_ns
        if silent_ns > self._max_wait_ns + 2 * period_ns:
            return False  # a LiDAR that stopped
        # The stamps that are expected next: newest + n * period, n = 1, 2, ...
        slack_ns = depths.spread_ns() + images.spread_ns()
        ahead = max(silent_ns // period_ns, 0)
        return any(
            abs(depths.newest_ns + n * period_ns - image.stamp_ns)
            <= min(self._max_skew_ns, image_period_ns // 2) + slack_ns
            for n in (ahead, ahead + 1)
            if n > 0
        )

    def _decide_image(self, decided: Decided, image: Message) -> None:
        depth = self._partner(image)
        older_depth = self._older_depth(image) if depth is None else None
        self.decided_ns = image.stamp_ns
        for older in list(self._images):
            if older.stamp_ns < image.stamp_ns:  # live alone
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
            if dead.stamp_ns < image.stamp_ns - self._max_skew_ns:  # images to come are newer
                self._discard_depth(decided, dead, Outcome.NO_IMAGE)
        self._forget_depths(decided, image.stamp_ns)

    def _discard_depth(self, decided: Decided, depth: Message, outcome: Outcome) -> None:
        self._depths.remove(depth)
        if outcome is Outcome.NO_IMAGE:
            self._keep(decided, depth, outcome)
        else:
            decided.discarded.append(Discarded(Sensor.DEPTH, depth, outcome))

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
        if depth in self._depths:  # images to come are farther from it than this one
            self._depths.remove(depth)
            self._keep(decided, depth, Outcome.REUSED)
        for kept in self._kept:
            if kept.depth is depth and kept.outcome is not None:
                kept.outcome = Outcome.REUSED

    def _forget_depths(self, decided: Decided, image_ns: int) -> None:
        """Drop those that no later image takes: all before the image but a recent one."""
        before = [kept for kept in self._kept if kept.depth.stamp_ns <= image_ns]
        if before and image_ns - before[-1].depth.stamp_ns < self._reuse_ns:
            before.pop()
        self._drop(decided, before)

    def _drop(self, decided: Decided, those: list[_Kept]) -> None:
        for kept in those:
            self._kept.remove(kept)
            if kept.outcome is not None:
                decided.discarded.append(Discarded(Sensor.DEPTH, kept.depth, kept.outcome))

    def _flush(self, decided: Decided, outcome: Outcome) -> None:
        if self._live:
            for image in reversed(self._images):  # the newest that has depth, else the newest
                if self._partner(image) is not None:
                    self._decide_image(decided, image)
                    break
        while self._images:
            self._decide_image(decided, self._images[-1 if self._live else 0])
        for depth in list(self._depths):
            self._discard_depth(decided, depth, outcome)
        self._drop(decided, list(self._kept))

    def _partner(self, image: Message) -> Message | None:
        """The nearest depth map to which no other image is nearer; the older of two as near."""
        own = (
            depth
            for depth in self._depths
            if _distance(image, depth) <= self._max_skew_ns
            and not any(_distance(other, depth) < _distance(image, depth) for other in self._images)
        )
        return min(own, key=lambda depth: _distance(image, depth), default=None)

    def _is_certain(self, image: Message, depth: Message) -> bool:
        """Whether no later message can be nearer to one of two partners."""
        skew = _distance(image, depth)
        next_depth_ns = self._sensors[Sensor.DEPTH].next_ns(self._live)
        next_image_ns = self._sensors[Sensor.IMAGE].next_ns(self._live)
        return (
            next_depth_ns - image.stamp_ns >= skew
            and next_image_ns - depth.stamp_ns >= depth.stamp_ns - image.stamp_ns
        )

    def _is_over(self, message: Message, other: Sensor, now_ns: int) -> bool:
        """Whether a message has waited long enough for the `other` sensor."""
        if self._live:
            return now_ns - message.arrived_ns >= self._max_wait_ns
        ahead_ns = self._sensors[other].newest_ns
        wait_ns = self._max_skew_ns + self._max_wait_ns
        return ahead_ns is not None and ahead_ns > message.stamp_ns + wait_ns

    def _near(self, depth: Message) -> bool:
        """Whether an image waits that may still be matched with this depth map."""
        return any(_distance(image, depth) <= self._max_skew_ns for image in self._images)


class _Waiting:
    """Waiting messages of one sensor, and the history of its stamps."""

    def __init__(self) -> None:
        self.messages: list[Message] = []  # by stamp
        self.remembered: deque[int] = deque(maxlen=_REMEMBERED)
        self.newest_ns: int | None = None
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def add(self, message: Message) -> None:
        insort(self.messages, message, key=lambda item: item.stamp_ns)
        self.remembered.append(message.stamp_ns)
        if self.newest_ns is None or message.stamp_ns > self.newest_ns:
            if self.newest_ns is not None:
                self._intervals.append(message.stamp_ns - self.newest_ns)
            self.newest_ns = message.stamp_ns

    def period_ns(self) -> int | None:
        """The median interval; None before `_KNOWN` intervals."""
        return median_low(self._intervals) if len(self._intervals) >= _KNOWN else None

    def spread_ns(self) -> int:
        """How far intervals are from the period: the mean distance of those that are one."""
        period_ns = self.period_ns()
        if period_ns is None:
            return 0
        single = [each for each in self._intervals if each < 1.5 * period_ns]
        return sum(abs(each - period_ns) for each in single) // len(single)

    def next_ns(self, live: bool) -> int:
        """The earliest possible next stamp; only after a first message."""
        assert self.newest_ns is not None
        return self.newest_ns + (min(self._intervals, default=0) if live else 0)


def _distance(one: Message, other: Message) -> int:
    return abs(one.stamp_ns - other.stamp_ns)
