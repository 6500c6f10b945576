"""What became of everything that was pushed."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Sensor(StrEnum):
    """Where a message comes from."""

    IMAGE = "image"
    DEPTH = "depth"


class Fate(StrEnum):
    """What became of a message. All but ANSWERED have a reason."""

    ANSWERED = "answered"
    DROPPED = "dropped"
    UNMATCHED = "unmatched"
    ERROR = "error"


# Reasons of DROPPED:
OVERTAKEN = "overtaken"  # live: a newer frame was complete before its turn came
INCOMPLETE = "incomplete"  # live: an image without depth gave way to a complete frame
UNREAD = "unread"  # live: its answer was not fetched before the next one was there
OVERFLOW = "overflow"  # live: more messages than can wait
DUPLICATE = "duplicate"  # a stamp of this sensor that was there before
LATE = "late"  # older than an image that was already decided
CLOSED = "closed"  # pushed after the stream was closed
INTERRUPTED = "interrupted"  # replay: Ctrl-C came while the push waited for room
# Reasons of UNMATCHED:
NO_IMAGE = "no_image"  # depth: no image within max_skew_ms
CLOCK_JUMP = "clock_jump"  # depth: it waited when the stamps jumped back
# Reasons of ERROR:
BAD_STAMP = "bad_stamp"
BAD_MESSAGE = "bad_message"  # refused by push_image, push_depth or push_points
INPUT_ERROR = "input_error"  # image and depth do not fit each other, or the model
INFERENCE_ERROR = "inference_error"


@dataclass(frozen=True)
class SensorCounts:
    """Messages of one sensor: `pushed` is the sum of all the others.

    dropped, unmatched, errors: reason -> how many. pending: not decided yet, or just being answered
    """

    pushed: int = 0
    answered: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    unmatched: Mapping[str, int] = field(default_factory=dict)
    errors: Mapping[str, int] = field(default_factory=dict)

    @property
    def pending(self) -> int:
        """Messages that are still waiting or being answered; 0 after the stream was closed."""
        fates = (self.dropped, self.unmatched, self.errors)
        return self.pushed - self.answered - sum(sum(fate.values()) for fate in fates)


@dataclass(frozen=True)
class StreamCounts:
    """All messages of a stream, a copy taken at one moment.

    `pushed` is the sum of `answered`, `dropped`, `unmatched`, `errors` and `pending`, all of them
    in messages: an answer made of an image and a depth map is two.

    images, depths: the same a sensor; `images.answered` is the number of answers
    camera_only: answers among them without depth
    out_of_order: messages that were older than the sensor's newest; what became of them is counted
        as for any other
    jumps_back: how often a sensor's stamps jumped back by more than a second
    """

    images: SensorCounts
    depths: SensorCounts
    camera_only: int
    out_of_order: int
    jumps_back: int

    @property
    def pushed(self) -> int:
        """Messages pushed."""
        return self.images.pushed + self.depths.pushed

    @property
    def answered(self) -> int:
        """Messages that went into an answer."""
        return self.images.answered + self.depths.answered

    @property
    def dropped(self) -> dict[str, int]:
        """Messages dropped, by reason."""
        return dict(Counter(self.images.dropped) + Counter(self.depths.dropped))

    @property
    def unmatched(self) -> dict[str, int]:
        """Messages that found no partner and were not answered alone, by reason."""
        return dict(Counter(self.images.unmatched) + Counter(self.depths.unmatched))

    @property
    def errors(self) -> dict[str, int]:
        """Messages that were refused or failed, by reason."""
        return dict(Counter(self.images.errors) + Counter(self.depths.errors))

    @property
    def pending(self) -> int:
        """Messages that are still waiting or being answered."""
        return self.images.pending + self.depths.pending


class Ledger:
    """Counts every message once when it is pushed and once when its fate is known.

    Not for several threads at a time: the stream guards it with its lock.
    """

    def __init__(self) -> None:
        self._pushed: Counter[Sensor] = Counter()
        self._fates: Counter[tuple[Sensor, Fate, str]] = Counter()
        self.camera_only = 0

    def push(self, sensor: Sensor) -> None:
        """A message has come."""
        self._pushed[sensor] += 1

    def settle(self, sensor: Sensor, fate: Fate, reason: str = "") -> None:
        """Its fate is known."""
        self._fates[sensor, fate, reason] += 1

    def revoke_answer(self, sensor: Sensor, reason: str) -> None:
        """An answer was made but nobody took it: it counts as dropped."""
        self._fates[sensor, Fate.ANSWERED, ""] -= 1
        self._fates[sensor, Fate.DROPPED, reason] += 1

    def counts(self, *, out_of_order: int, jumps_back: int) -> StreamCounts:
        """A copy of the state."""
        return StreamCounts(
            images=self._of(Sensor.IMAGE),
            depths=self._of(Sensor.DEPTH),
            camera_only=self.camera_only,
            out_of_order=out_of_order,
            jumps_back=jumps_back,
        )

    def _of(self, sensor: Sensor) -> SensorCounts:
        def by_reason(fate: Fate) -> dict[str, int]:
            return {
                reason: count
                for (of, kind, reason), count in self._fates.items()
                if of is sensor and kind is fate
            }

        return SensorCounts(
            pushed=self._pushed[sensor],
            answered=self._fates[sensor, Fate.ANSWERED, ""],
            dropped=by_reason(Fate.DROPPED),
            unmatched=by_reason(Fate.UNMATCHED),
            errors=by_reason(Fate.ERROR),
        )
