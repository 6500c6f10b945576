"""The frames of a recording before they are read, matched by the stamps of its messages."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from runtime.base.natural_order import normal_form
from runtime.base.stamp import JUMP_BACK_NS
from runtime.geometry.rig import Rig
from runtime.streams.matching import Pair, RecordingMatcher
from runtime.streams.messages import MATCHED, Place, Sensor

_WAITING = 64  # messages of a sensor that wait for a silent one
_FIRST_PART = 1024  # messages, after which a list of some frames may be complete


@dataclass(frozen=True)
class ListedFrame:
    """A frame that a source has not read yet.

    Attributes:
        sequence: index in the source, from 0.
        name: name of the frame and of its output files, unique in the source.
        image: where the source finds the image (a path, an index, ...); None if there is no image.
        depth: where the source finds the depth; None if there is no depth.
        image_stamp_ns: time of the image by its sensor's clock [ns]; None if unknown.
        depth_stamp_ns: time of the depth by its sensor's clock [ns]; None if unknown.
        complete: whether the frame has an image and depth of its own, or only an image if the
            source reads no depth.
        reused: whether the depth is an older scan, because the image has none of its own.
    """

    sequence: int
    name: str
    image: Any
    depth: Any
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    complete: bool = True
    reused: bool = False


@dataclass
class Listing:
    """The frames of messages with stamps, and the messages without a frame.

    Attributes:
        frames: the frames in the order of their images.
        stamps_ns: stamps of each sensor, including messages that belong to no frame.
        left_out: counts of the messages that are in no frame, such as "image: duplicate".
    """

    frames: tuple[ListedFrame, ...] = ()
    stamps_ns: dict[Sensor, list[int]] = field(default_factory=lambda: {s: [] for s in MATCHED})
    left_out: Counter[str] = field(default_factory=Counter)


def list_places(
    places: Iterable[Place], rig: Rig, *, limit: int | None, camera_only: bool
) -> Listing:
    """List the frames of messages, whatever the order in which their topics were written.

    Args:
        places: the messages in the order of the recording. Those of a long recording are read as
            far as `limit` needs them.
        rig: says which stamps belong together, and how old depth may be that is reused.
        limit: the list ends after this number of complete frames; None: all frames are listed.
        camera_only: whether the recording has no depth, so that an image alone is complete.
    """
    read: list[Place] = []
    unread = iter(places)
    while True:
        part = None if limit is None else max(len(read), _FIRST_PART)
        before = len(read)
        read += islice(unread, part)
        listing = Listing()
        pairs = _matched(RecordingMatcher(rig, _WAITING), read, listing)
        listing.frames = limit_frames(_listed(pairs, camera_only), limit)
        if part is None or len(read) < before + part or _is_settled(listing, read, camera_only):
            return listing


def _matched(
    matching: RecordingMatcher[Place], read: Sequence[Place], listing: Listing
) -> Iterator[Pair[Place]]:
    def stamped() -> Iterator[Place]:
        for place in _in_order(read):
            listing.stamps_ns[place.sensor].append(place.stamp_ns)
            yield place

    for decided in matching.match(stamped()):
        listing.left_out.update(f"{gone.sensor}: {outcome}" for gone, outcome in decided.discarded)
        yield from decided.pairs


def _in_order(places: Iterable[Place]) -> Iterator[Place]:
    """Sort messages by their stamps within each stretch between two jumps back of the clock."""
    stretch: list[Place] = []
    newest_ns: dict[Sensor, int] = {}
    for place in places:
        last_ns = newest_ns.get(place.sensor, place.stamp_ns)
        if place.stamp_ns < last_ns - JUMP_BACK_NS:
            yield from sorted(stretch, key=lambda each: each.stamp_ns)
            stretch, newest_ns, last_ns = [], {}, place.stamp_ns
        newest_ns[place.sensor] = max(last_ns, place.stamp_ns)
        stretch.append(place)
    yield from sorted(stretch, key=lambda each: each.stamp_ns)


def _is_settled(listing: Listing, read: Sequence[Place], camera_only: bool) -> bool:
    """Whether later messages are too new to change the list, as each sensor is beyond its end."""
    newest = {place.sensor: place.stamp_ns for place in read}  # the last one of each
    sensors = MATCHED[:1] if camera_only else MATCHED
    last_ns = listing.frames[-1].image_stamp_ns if listing.frames else None
    if last_ns is None:
        return False
    return all(newest.get(each, last_ns) > last_ns + JUMP_BACK_NS for each in sensors)


def _listed(pairs: Iterable[Pair[Place]], camera_only: bool) -> Iterator[ListedFrame]:
    """Name frames by their files, or else by the stamps of their images."""
    names: Counter[str] = Counter()
    for sequence, (image, depth, reused) in enumerate(pairs):
        name = normal_form(image.at.stem) if isinstance(image.at, Path) else str(image.stamp_ns)
        names[name] += 1
        if names[name] > 1:  # a recording of one that was played in a loop
            name = f"{name}-{names[name]}"
        at, depth_ns = (None, None) if depth is None else (depth.at, depth.stamp_ns)
        whole = camera_only if depth is None else not reused
        yield ListedFrame(sequence, name, image.at, at, image.stamp_ns, depth_ns, whole, reused)


def left_out_note(left_out: Mapping[str, int]) -> tuple[str, ...]:
    """One line with the counts of what is in no frame, or no line if there is nothing."""
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(left_out.items()))
    return (f"left out: {counts}",) if counts else ()


def limit_frames(frames: Iterable[ListedFrame], limit: int | None) -> tuple[ListedFrame, ...]:
    """The frames up to the `limit`-th complete one."""
    listed: list[ListedFrame] = []
    complete = 0
    for frame in frames:
        listed.append(frame)
        complete += frame.complete
        if complete == limit:
            break
    return tuple(listed)
