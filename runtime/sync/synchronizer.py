"""The matching of a live stream, where the newest complete frame wins.

The present time is an argument: there is no clock. A match is certain if no later message can be
nearer in time. The next stamp of a sensor is expected after its shortest recent interval at the
earliest (the "inter-message lower bound" of ROS's approximate time policy, learned here). While its
match is not certain, a message waits for at most `max_wait_ns`. Then an image is decided with the
nearest depth map that is there, or without depth, and a depth map is unmatched. An image does not
wait if, by the periods of both sensors, no depth map will come for it.
"""

from runtime.sync.matching import Decided, Discarded, Matching, Message
from runtime.sync.outcome import Outcome, Sensor


class Synchronizer(Matching):
    """Matches messages as they arrive; deciding an image discards all older images."""

    def __init__(
        self, *, max_skew_ns: int, max_wait_ns: int, capacity: int, reuse_ns: int = 0
    ) -> None:
        super().__init__(max_skew_ns=max_skew_ns, reuse_ns=reuse_ns, capacity=capacity)
        self._max_wait_ns = max_wait_ns
        self._now_ns = 0

    def add(self, sensor: Sensor, message: Message) -> Decided:
        """Take a message that has just arrived, and decide what is certain with it."""
        decided = Decided()
        self._now_ns = message.arrived_ns
        if self._admit(decided, sensor, message):
            self._decide(decided)
            waiting = self._sensors[sensor].messages
            if len(waiting) > self._capacity:
                decided.discarded.append(Discarded(sensor, waiting.pop(0), Outcome.OVERFLOW))
        return decided

    def advance(self, now_ns: int) -> Decided:
        """Decide what has waited long enough."""
        decided = Decided()
        self._now_ns = now_ns
        self._decide(decided)
        return decided

    def due_ns(self) -> int | None:
        """When to call `advance` next; None = only after another message."""
        # A depth map near a waiting image is decided together with this image.
        waiting = [*self._images, *(depth for depth in self._depths if not self._near(depth))]
        arrived_ns = min((message.arrived_ns for message in waiting), default=None)
        return None if arrived_ns is None else arrived_ns + self._max_wait_ns

    def _next_decidable(self) -> Message | None:
        """The newest of the images that can be decided."""
        for image in reversed(self._images):
            depth = self._partner(image)
            if depth is not None and self._is_certain(image, depth):
                return image
            if self._is_over(image, Sensor.DEPTH):
                return image
        # The oldest image, if no depth map is expected for it. A newer image has to wait, because
        # deciding it would discard the oldest.
        oldest = next(iter(self._images), None)
        if oldest is None or self._partner(oldest) is not None or self._is_due(oldest):
            return None
        return oldest

    def _is_due(self, image: Message) -> bool:
        """Whether a depth map may still arrive whose nearest image is this image."""
        depths = self._sensors[Sensor.DEPTH].intervals
        images = self._sensors[Sensor.IMAGE].intervals
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

    def _is_over(self, message: Message, other: Sensor) -> bool:
        return self._now_ns - message.arrived_ns >= self._max_wait_ns

    def _next_ns(self, sensor: Sensor) -> int:
        intervals = self._sensors[sensor].intervals
        assert intervals.newest_ns is not None
        return intervals.newest_ns + intervals.shortest_ns

    def _decide_images(self, decided: Decided) -> None:
        complete = [image for image in self._images if self._partner(image) is not None]
        for image in complete[-1:]:
            self._decide_image(decided, image)
        for image in self._images[-1:]:
            self._decide_image(decided, image)
