"""The messages of some topics of a bag, read once in their order, for frames that need them."""

from collections.abc import Iterator, Sequence

from runtime.base.errors import InputError
from runtime.recordings.ros_bag import RecordedMessage, RosBag
from runtime.recordings.source import ListedFrame


class BagMessages:
    """Messages by their position among those of the topics.

    Messages of later frames are read ahead and kept until the last frame that needs them.
    """

    def __init__(self, bag: RosBag, topics: Sequence[str]) -> None:
        self._bag, self._topics = bag, topics
        self.expect(())

    def expect(self, frames: Sequence[ListedFrame]) -> None:
        """Start anew, for these frames."""
        # Maps the position of a message to the sequence of the last frame that needs it.
        self._owners = {place: f.sequence for f in frames for place in (f.image, f.depth)}
        self._kept: dict[int, RecordedMessage] = {}
        self._messages, self._next_place = iter(self), 0

    def __iter__(self) -> Iterator[tuple[int, RecordedMessage]]:
        """Yield (position, message), in the same order each time."""
        return enumerate(self._bag.messages(self._topics))

    def take(self, frame: ListedFrame) -> dict[int, RecordedMessage]:
        """The messages of a frame by position; messages of later frames are read ahead and kept."""
        places = {place for place in (frame.image, frame.depth) if place is not None}
        missing = places - self._kept.keys()
        if missing and min(missing) < self._next_place:
            self._messages, self._next_place = iter(self), 0
        while not places <= self._kept.keys():
            place, message = next(self._messages, (-1, None))
            if message is None:
                raise InputError(f"{self._bag.path} ends before {frame.name}: was it replaced?")
            self._next_place = place + 1
            if self._owners.get(place, -1) >= frame.sequence:
                self._kept[place] = message
        taken = {place: self._kept[place] for place in places}
        # A scan may serve later images as well.
        kept = self._kept.items()
        self._kept = {place: each for place, each in kept if self._owners[place] > frame.sequence}
        return taken
