"""Bags of ROS 1 and ROS 2 and MCAP files: topics and messages, through `rosbags` (extra `bag`)."""

import contextlib
import os
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from runtime.checks import cut
from runtime.errors import InputError, SSDNetError, import_remedy
from runtime.read_input import MAX_TEXT_BYTES, require_regular

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys.store import Typestore

#: Largest decompressed size of a chunk of a bag, as its index declares it.
MAX_CHUNK_BYTES = 2**28

_BAG_SUFFIXES = (".yaml", ".db3", ".mcap", ".zstd")
_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"


class RecordedMessage(NamedTuple):
    """A message as stored; `recorded_ns` is when it was recorded."""

    topic: str
    recorded_ns: int
    raw: bytes


class RosBag:
    """An open bag.

    Args:
        path: ROS 1 bag (.bag), ROS 2 bag (folder with metadata.yaml, or .db3), or .mcap.

    Attributes:
        types: topic -> message type, by the names of ROS 2.
        lost: topic -> messages that the bag's index has and the last complete reading did not.

    Raises:
        InputError: if `rosbags` cannot be imported, or the bag is damaged; so does every method.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.lost = path, Counter[str]()
        self._reader, self._definitions = _open(path)
        with _reading(self.path):
            self.types = {
                topic: info.msgtype or "several types"
                for topic, info in self._reader.topics.items()
            }

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of the topics in the order in which they were recorded."""
        with _reading(self.path):
            connections = [c for c in self._reader.connections if c.topic in topics]
            if connections:  # rosbags reads all topics if this is empty
                left = Counter({topic: self._reader.topics[topic].msgcount for topic in topics})
                for connection, recorded_ns, raw in self._reader.messages(connections):
                    left[connection.topic] -= 1
                    yield RecordedMessage(connection.topic, recorded_ns, raw)
                self.lost = +left  # only topics with messages left

    def decoded(self, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic with their fields."""
        return (self.decode(message) for message in self.messages([topic]))

    def first(self, topic: str) -> Any:
        """Return the first message of a topic. Raises InputError if there is none."""
        for message in self.decoded(topic):
            return message
        raise InputError(f"the topic {topic} of {self.path} has no messages")

    def decode(self, message: RecordedMessage) -> Any:
        """Return a message of a type of ROS itself, with its fields. Raises InputError."""
        store = self._definitions
        deserialize = store.deserialize_cdr if self._reader.is2 else store.deserialize_ros1
        try:
            return deserialize(message.raw, self.types[message.topic])
        except Exception as error:  # the parser of definitions may raise any type
            raise InputError(
                f"a message of {message.topic} in {self.path} is damaged ({_describe(error)})"
            ) from error

    def stamp_ns(self, message: RecordedMessage) -> int | None:
        """The time stamp [ns] of a message that starts with a std_msgs/Header; 0: none was set.

        None for a message that is too short. The rest of the message is not decoded: the stamp is
        at byte 4 in both formats, after `seq` in ROS 1, after the byte order in CDR.
        """
        is_cdr = self._reader.is2
        if len(message.raw) < 12:
            return None
        order = ">" if is_cdr and not message.raw[1] & 1 else "<"
        stamp = struct.unpack_from(f"{order}{'i' if is_cdr else 'I'}I", message.raw, 4)
        return int(stamp[0]) * 10**9 + int(stamp[1])

    def close(self) -> None:
        """Close the files. May be called again."""
        with contextlib.suppress(Exception):  # closed before
            self._reader.close()


def _open(path: Path) -> "tuple[AnyReader, Typestore]":
    """The open bag, and ROS's own message definitions: those in the bag may be damaged."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        remedy = import_remedy(error, "bag")
        raise InputError(f"rosbags cannot be imported to read bags ({error}): {remedy}") from error
    files = [path]
    if os.path.isdir(path):
        files = [file for file in path.iterdir() if file.suffix in _BAG_SUFFIXES]
    for file in files:
        require_regular(file, max_bytes=MAX_TEXT_BYTES if file.suffix == ".yaml" else None)
    is_ros1 = path.suffix == ".bag"
    definitions = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            definitions.register(get_types_from_msg(_TRANSFORMS, name))
    with _reading(path):
        # Bags before ROS 2 Iron hold no definitions.
        reader = AnyReader([path], default_typestore=definitions)
        reader.open()
        if (size := max(_declared_sizes(reader), default=0)) > MAX_CHUNK_BYTES:
            raise InputError(
                f"a compressed part has {size:,} bytes, expected at most {MAX_CHUNK_BYTES:,}"
            )
    return reader, definitions


def _declared_sizes(reader: "AnyReader") -> Iterator[int]:
    """The decompressed sizes that the index of a bag declares for its compressed parts."""
    bag: Any
    (bag,) = reader.readers
    if reader.is2:
        storages = getattr(bag.storage, "storages", [bag.storage])  # of a folder, or the only file
        chunks = [chunk for each in storages for chunk in getattr(each, "chunks", ())]  # of MCAP
        yield from (chunk.uncompressed_size for chunk in chunks if chunk.compression)
        return
    from rosbags.rosbag1.reader import Header

    for chunk in bag.chunk_infos:
        bag.bio.seek(chunk.pos)
        header = Header.read(bag.bio)
        if header.get_string("compression") != "none":
            yield header.get_uint32("size")


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Raise as InputError whatever a damaged bag makes the libraries raise."""
    try:
        yield
    except SSDNetError:
        raise
    except Exception as error:
        raise InputError(
            f"cannot read the bag {path} ({_describe(error)}): it is truncated, damaged or no bag. "
            "rosbag reindex, ros2 bag reindex or mcap recover may repair it"
        ) from error


def _describe(error: Exception) -> str:
    return cut(f"{type(error).__name__}: {error}", 200)
