"""The messages of some topics of a bag, read once in their order, for frames that need them."""

from collections.abc import Iterator, Mapping, Sequence

from runtime.base.errors import InputError
from runtime.recordings.listing import ListedFrame
from runtime.recordings.ros_bag import RecordedMessage, RosBag

_FAR = 256  # positions between the image and the depth of a frame, if topics are apart in the file


class BagMessages:
    """Messages by their position among those of the topics.

    Messages of later frames are read ahead and kept until the last frame that needs them. Where
    topics were written one after the other, each sensor has a reader of its own, so that few wait.
    """

    def __init__(self, bag: RosBag, topics: Sequence[str]) -> None:
        self._bag, self._topics = bag, topics
        self._second: RosBag | None = None  # open where topics are apart
        self.expect(())

    def expect(self, frames: Sequence[ListedFrame]) -> None:
        """Start anew, for these frames."""
        images = {f.image: f.sequence for f in frames}
        depths = {f.depth: f.sequence for f in frames}
        apart = (abs(f.image - f.depth) for f in frames if f.depth is not None and not f.reused)
        self.close()
        if max(apart, default=0) > _FAR:
            self._second = RosBag(self._bag.path)
            self._images = _Reader(self._bag, self._topics, images)
            self._depths = _Reader(self._second, self._topics, depths)
        else:
            self._images = self._depths = _Reader(self._bag, self._topics, images | depths)

    def __iter__(self) -> Iterator[tuple[int, RecordedMessage]]:
        """Yield (position, message), in the same order each time."""
        return enumerate(self._bag.messages(self._topics))

    def take(self, frame: ListedFrame) -> tuple[RecordedMessage, RecordedMessage | None]:
        """The messages of the image and the depth of a frame."""
        image = self._images.take(frame.image, frame)
        return image, None if frame.depth is None else self._depths.take(frame.depth, frame)

    def close(self) -> None:
        """Close what `expect` has opened."""
        if self._second is not None:
            self._second.close()
            self._second = None


class _Reader:
    """Reads a bag forwards; `owners` maps a position to the last frame that needs its message."""

    def __init__(self, bag: RosBag, topics: Sequence[str], owners: Mapping[int, int]) -> None:
        self._bag, self._topics, self._owners = bag, topics, owners
        self._kept: dict[int, RecordedMessage] = {}
        self._rewind()

    def _rewind(self) -> None:
        self._messages, self._next_place = enumerate(self._bag.messages(self._topics)), 0

    def take(self, place: int, frame: ListedFrame) -> RecordedMessage:
        kept = self._kept.items()
        self._kept = {at: each for at, each in kept if self._owners[at] >= frame.sequence}
        if place not in self._kept and place < self._next_place:
            self._rewind()
        while place not in self._kept:
            at, message = next(self._messages, (-1, None))
            if message is None:
                raise InputError(f"{self._bag.path} ends before {frame.name}: was it replaced?")
            self._next_place = at + 1
            if self._owners.get(at, -1) >= frame.sequence:
                self._kept[at] = message
        return self._kept[place]
