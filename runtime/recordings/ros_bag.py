"""Bags of ROS 1 and ROS 2 and MCAP files: topics and messages, read by `rosbags` (extra `bag`)."""

import contextlib
import importlib.util
import os
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from runtime.base.arguments import cut
from runtime.base.errors import InputError, SSDNetError, import_remedy
from runtime.base.process_guard import SHARED_FILES, ProcessGuard
from runtime.files.read_input import MAX_TEXT_BYTES, open_input, require_regular

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

# Largest size of a chunk of a bag after decompression, as declared by the bag's index.
MAX_CHUNK_BYTES = 2**28

_BAG_SUFFIXES = (".yaml", ".db3", ".mcap", ".zstd")
_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
_ZSTD = b"\x28\xb5\x2f\xfd"  # start of compressed data, with which no message in CDR begins


class RecordedMessage(NamedTuple):
    """A message as it is stored; `recorded_ns` is the time at which it was recorded."""

    topic: str
    recorded_ns: int
    raw: bytes


class RosBag:
    """An open bag.

    Args:
        path: a ROS 1 bag (.bag), a ROS 2 bag (folder with metadata.yaml, or .db3) or an .mcap file.

    Attributes:
        types: the message type of each topic, by its name in ROS 2.
        left_out: counts of what is not read; messages are counted when they are met.
        guard: guard of the process that may read the bag.

    Raises:
        InputError: if `rosbags` cannot be imported, or the bag is damaged. All methods raise it,
            too.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.types, self.left_out = path, dict[str, str](), Counter[str]()
        self._is_cdr = path.suffix.lower() != ".bag"
        self.guard = ProcessGuard("BagSource", SHARED_FILES, InputError)
        self._reader, self._definitions = _open(path)
        self._topics: dict[str, list[Connection]] = {}
        with _reading(self.path):
            for c in self._reader.connections:
                encoding = getattr(c.ext, "serialization_format", "ros1")
                is_own = (encoding == "cdr") == self._is_cdr
                if is_own and self.types.setdefault(c.topic, c.msgtype) == c.msgtype:
                    self._topics.setdefault(c.topic, []).append(c)
                else:  # written by another library, or a second type of the same topic
                    self.left_out[f"{c.topic} ({encoding} {c.msgtype})"] += c.msgcount
            there = {file.name.removesuffix(".zstd") for file in _files(path)}
            named = {path.name, "metadata.yaml", *(s.path.name for s in _storages(self._reader))}
            for name in there - named:
                self.left_out[f"{name} (metadata.yaml does not name it)"] = 1

    def of_kind(self, *kinds: str) -> list[str]:
        """The topics of these message types, sorted."""
        return sorted(topic for topic, kind in self.types.items() if kind in kinds)

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of the topics in the order in which they were recorded."""
        self.guard.check()
        connections = [each for topic in topics for each in self._topics[topic]]
        left = Counter({t: sum(each.msgcount for each in self._topics[t]) for t in topics})
        with _reading(self.path):
            for connection, recorded_ns, raw in self._reader.messages(connections):
                left[connection.topic] -= 1
                if self._is_cdr and raw[:4] == _ZSTD:  # a file without its bag's metadata.yaml
                    raw = _decompress(raw)
                yield RecordedMessage(connection.topic, recorded_ns, raw)
        # A bag is read several times; the count is the largest of a single reading.
        self.left_out |= Counter({f"{t} (only in the index)": n for t, n in left.items()})

    def decoded(self, topic: str, check: Callable[[Any], object] = bool) -> Iterator[Any]:
        """Yield the messages of a topic with their fields.

        Messages that are damaged, or for which `check` raises InputError, are left out.
        """
        damaged = 0
        for message in self.messages([topic]):
            try:
                decoded = self.decode(message)
                check(decoded)
            except InputError:
                damaged += 1
                self.left_out |= Counter({f"{topic} (damaged)": damaged})
                continue
            yield decoded

    def first(self, topic: str) -> Any:
        """Return the first message of a topic. Raises InputError if there is none."""
        for message in self.decoded(topic):
            return message
        raise InputError(f"the topic {topic} of {self.path} has no message that can be decoded")

    def decode(self, message: RecordedMessage) -> Any:
        """Return the fields of a message whose type is one of ROS itself. Raises InputError."""
        store = self._definitions
        deserialize = store.deserialize_cdr if self._is_cdr else store.deserialize_ros1
        try:
            return deserialize(message.raw, self.types[message.topic])
        except Exception as error:  # the parser of definitions may raise any type
            raise InputError(
                f"a message of {message.topic} in {self.path} is damaged ({_describe(error)})"
            ) from error

    def stamp_ns(self, message: RecordedMessage) -> int | None:
        """The time stamp [ns] of a message that starts with a std_msgs/Header; 0 if none was set.

        The result is None if the message is too short. The rest of the message is not decoded: in
        both formats the stamp begins at byte 4, after `seq` in ROS 1 and after the byte order in
        CDR.
        """
        if len(message.raw) < 12:
            return None
        order = ">" if self._is_cdr and not message.raw[1] & 1 else "<"
        stamp = struct.unpack_from(f"{order}{'i' if self._is_cdr else 'I'}I", message.raw, 4)
        return int(stamp[0]) * 10**9 + int(stamp[1])

    def close(self) -> None:
        """Close the files. It may be called more than once."""
        with contextlib.suppress(Exception):  # it may be closed already
            self._reader.close()


def _open(path: Path) -> "tuple[Any, Typestore]":
    """The open bag and ROS's own message definitions, because those in the bag may be damaged."""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        remedy = import_remedy(error, "bag")
        raise InputError(f"rosbags cannot be imported to read bags ({error}): {remedy}") from error
    for file in _files(path):
        require_regular(file, max_bytes=MAX_TEXT_BYTES if file.suffix == ".yaml" else None)
        _require_merged(file)
    is_ros1 = path.suffix.lower() == ".bag"
    definitions = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            definitions.register(get_types_from_msg(_TRANSFORMS, name))
    with _reading(path):
        reader: Any = Reader1(path) if is_ros1 else Reader2(path)
        if os.path.isdir(path):
            plugin = {"mcap": _mcap_reader()}
            reader.storage.STORAGE_PLUGINS = reader.storage.STORAGE_PLUGINS | plugin
        elif path.suffix.lower() == ".mcap":
            reader.storage = _mcap_reader()(path)
        reader.open()
        if (size := max(_declared_sizes(reader), default=0)) > MAX_CHUNK_BYTES:
            raise InputError(
                f"a compressed part has {size:,} bytes, expected at most {MAX_CHUNK_BYTES:,}"
            )
        for chunks in (getattr(each, "chunks", []) for each in _storages(reader)):
            if not any(chunk.message_index_offsets for chunk in chunks):
                chunks.clear()  # a valid file without an index of its messages: it is scanned
    return reader, definitions


def _files(path: Path) -> list[Path]:
    there = path.iterdir() if os.path.isdir(path) else [path]
    return [file for file in there if file == path or file.suffix in _BAG_SUFFIXES]


def _require_merged(file: Path) -> None:
    """Raise InputError for a database if SQLite left a part of it in a journal beside it."""
    journals = (Path(f"{os.path.realpath(file)}{end}") for end in ("-wal", "-journal"))
    for journal in filter(os.path.lexists, journals):
        with open_input(journal, max_bytes=None) as opened:
            start = opened.read(33)
        if len(start) == 33 and any(start[:28]):  # else the journal is empty, or marked as done
            raise InputError(
                f"{file} lacks what its recorder left in {journal.name}: sqlite3 {file} "
                "'PRAGMA journal_mode = DELETE' merges the two"
            )


def _mcap_reader() -> Any:
    """The class with which rosbags reads MCAP, without the definitions of messages.

    The original fails at definitions of channels that do not belong to ROS, and at files without an
    index whose messages are not sorted. The change is made in a copy of its module, so that others
    who use rosbags are not affected.
    """
    from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

    spec: Any = importlib.util.find_spec("rosbags.rosbag2.storage_mcap")
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.get_msgdef = lambda schema: MessageDefinition(MessageDefinitionFormat.NONE, "")
    module.read_string = lambda file: module.read_bytes(file).decode(errors="replace")

    class McapReader(module.McapReader):  # type: ignore[misc]
        def messages(self, *args: Any, **limits: Any) -> Any:
            return (super().messages if self.chunks else self.messages_scan)(*args, **limits)

    return McapReader


def _storages(reader: Any) -> list[Any]:
    """The readers of the files of a ROS 2 bag."""
    storage = getattr(reader, "storage", None)
    return getattr(storage, "storages", [storage] if storage else [])  # of a folder, or of one file


def _decompress(raw: bytes) -> bytes:
    from rosbags.rosbag2.reader import zstd  # type: ignore[attr-defined]  # Python's or a backport

    with contextlib.suppress(zstd.ZstdError):
        return bytes(zstd.ZstdDecompressor().decompress(raw, MAX_CHUNK_BYTES))
    return b""  # stands for a damaged message


def _declared_sizes(reader: Any) -> Iterator[int]:
    """The sizes after decompression that a bag's index declares for its compressed parts."""
    from rosbags.rosbag1.reader import Header

    chunks = [chunk for each in _storages(reader) for chunk in getattr(each, "chunks", ())]
    yield from (chunk.uncompressed_size for chunk in chunks if chunk.compression)  # MCAP
    for chunk in getattr(reader, "chunk_infos", ()):  # ROS 1
        reader.bio.seek(chunk.pos)
        header = Header.read(reader.bio)
        if header.get_string("compression") != "none":
            yield header.get_uint32("size")


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn whatever a damaged bag makes the libraries raise into an InputError."""
    try:
        yield
    except SSDNetError:
        raise
    except Exception as error:
        raise InputError(
            f"cannot read the bag {path} ({_describe(error)}): convert it if it is MCAP of ROS 1; "
            "rosbag reindex, ros2 bag reindex or mcap recover may repair it if it is damaged"
        ) from error


def _describe(error: Exception) -> str:
    return cut(f"{type(error).__name__}: {error}", 200)
