"""What a bag holds beside messages that can be read: journals, other encodings, damaged ones."""

import contextlib
import shutil
import sqlite3
import struct

import pytest

import runtime.recordings.ros_bag
from runtime import InputError
from runtime.recordings.bag import BagSource
from runtime.recordings.ros_bag import RosBag
from small_rig import MS, START_NS

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

N = 4


def frames_of(path, **options):
    with BagSource(path, **options) as source:
        frames = [source.read(frame) for frame in source.list_frames()]
        return len(frames), source.inputs["left_out"]


def killed(file, mode, *, at):
    """Copy a database with the journal that a killed recorder leaves, half of it in there."""
    shutil.copy(file, at.with_suffix(".live"))
    with contextlib.closing(sqlite3.connect(at.with_suffix(".live"))) as live:
        live.execute(f"PRAGMA journal_mode={mode}")
        live.execute("PRAGMA cache_size=1")  # pages are written before the end
        half = live.execute("SELECT count(*) FROM messages").fetchone()[0] // 2
        if mode == "WAL":
            rows = live.execute("SELECT * FROM messages WHERE id > ?", [half]).fetchall()
            live.execute("DELETE FROM messages WHERE id > ?", [half])
            live.commit()
            live.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            marks = ",".join("?" * len(rows[0]))
            live.executemany(f"INSERT INTO messages VALUES ({marks})", rows)
            live.commit()
        else:
            live.execute("DELETE FROM messages WHERE id > ?", [half])  # and no commit
        for end in ("", "-wal", "-journal"):
            if (source := at.with_name(at.with_suffix(".live").name + end)).exists():
                shutil.copy(source, f"{at}{end}")


@pytest.mark.parametrize(("mode", "end"), [("WAL", "-wal"), ("DELETE", "-journal")])
def test_a_database_is_not_read_without_its_journal(tmp_path, record, mode, end):
    (file,) = record("ros2").write().glob("*.db3")
    killed(file, mode, at=tmp_path / "killed.db3")
    (tmp_path / "link.db3").symlink_to("killed.db3")
    for name in ("killed.db3", "link.db3"):
        with pytest.raises(InputError, match=rf"killed\.db3{end}"):
            RosBag(tmp_path / name)
    with contextlib.closing(sqlite3.connect(tmp_path / "killed.db3")) as merged:
        merged.execute("PRAGMA journal_mode = DELETE")  # the command of the error
    assert frames_of(tmp_path / "killed.db3") == (N, {})


def test_a_bag_without_definitions_is_read_by_those_of_ros_2(record):
    """As before ROS 2 Iron."""
    path = record("ros2").write()
    with contextlib.closing(sqlite3.connect(next(path.glob("*.db3")))) as database, database:
        database.execute("DELETE FROM message_definitions")
    assert frames_of(path) == (N, {})


PACKED = [("ros1", "bz2"), ("ros1", "lz4"), ("ros2", "message"), ("mcap", "storage")]


@pytest.mark.parametrize(("kind", "compression"), PACKED)
def test_a_compressed_bag_is_read_up_to_a_declared_size(record, monkeypatch, kind, compression):
    path = record(kind).write(compression=compression)
    assert frames_of(path) == (N, {})
    if compression == "message":
        return  # no size is declared before the message itself
    monkeypatch.setattr(runtime.recordings.ros_bag, "MAX_CHUNK_BYTES", 1000)
    with pytest.raises(InputError, match="1,000"):
        BagSource(path)


def test_messages_that_the_index_promises_and_the_bag_has_lost_are_counted(record):
    """A part of the data is zeroed, as a failing disk leaves it."""
    bag = record(images=200, scans=0)  # several chunks
    path = bag.write()
    content = bytearray(path.read_bytes())
    size = 22 + len(bag.messages[0][2])
    start = content.index(struct.pack("<BQ", 5, size))
    length = 9 * (9 + size)  # nine messages: also a whole number of empty records
    content[start : start + length] = bytes(length)
    path.write_bytes(content)
    with BagSource(path, depth_topic="none") as source:
        for _ in range(2):
            assert len(source.list_frames()) == 191
        missing = "/cam/image_rect (only in the index)"
        assert source.inputs["left_out"] == {missing: 9}
        assert f"left out: {missing} 9" in source.notes


@pytest.mark.parametrize(("end", "content"), [
    ("-wal", b""), ("-wal", bytes(32)), ("-journal", bytes(512)), ("-shm", b"x" * 99),
])  # fmt: skip
def test_a_journal_without_pages_changes_nothing(record, end, content):
    path = record("ros2").write()
    (file,) = path.glob("*.db3")
    file.with_name(file.name + end).write_bytes(content)
    assert frames_of(path) == (N, {})


def test_a_file_that_metadata_does_not_name_is_reported(record):
    path = record("ros2").write()
    (file,) = path.glob("*.db3")
    shutil.copy(file, path / "drive_1.db3")
    assert frames_of(path) == (N, {"drive_1.db3 (metadata.yaml does not name it)": 1})


def test_a_compressed_database_is_read_without_its_metadata(record):
    bag = record("ros2")
    (file,) = bag.write(compression="message").glob("*.db3")
    assert frames_of(file) == (N, {})
    with contextlib.closing(sqlite3.connect(file)) as database, database:
        last = "SELECT max(messages.id) FROM messages JOIN topics ON topics.id = topic_id"
        last += " WHERE name = '/cam/image_rect'"
        database.execute(f"UPDATE messages SET data = substr(data, 1, 12) WHERE id = ({last})")
    assert frames_of(file) == (N - 1, {"image: bad_stamp": 1, "depth: no_image": 1})


def write_mcap(path, bag, others):
    """Write the messages of a bag and a message of each of (topic, encoding, type, schema)."""

    def text(value):
        content = value if isinstance(value, bytes) else value.encode()
        return struct.pack("<I", len(content)) + content

    def record(code, body):
        return bytes([code]) + struct.pack("<Q", len(body)) + body

    kinds = {topic: kind for topic, kind, _, _ in bag.messages}
    channels = [(topic, "cdr", kind, "ros2msg", "") for topic, kind in kinds.items()]
    content = b"\x89MCAP0\r\n" + record(1, text("ros2") + text("test"))
    for index, (topic, encoding, kind, schema, data) in enumerate([*channels, *others], 1):
        schemas = struct.pack("<H", index) + text(kind) + text(schema) + text(data)
        channel = struct.pack("<HH", index, index) + text(topic) + text(encoding) + bytes(4)
        content += record(3, schemas) + record(4, channel)
    messages = [(list(kinds).index(topic), ns, raw) for topic, _, raw, ns in bag.messages]
    messages += [(len(kinds) + index, START_NS, b"{}") for index in range(len(others))]
    for channel, ns, raw in sorted(messages, key=lambda each: each[1]):
        content += record(5, struct.pack("<HIQQ", channel + 1, 0, ns, ns) + raw)
    path.write_bytes(content + record(15, bytes(4)) + record(2, bytes(20)) + b"\x89MCAP0\r\n")
    return path


def test_channels_of_other_encodings_are_left_out(tmp_path, record):
    others = [
        ("/events", "json", "Event", "jsonschema", "{}"),
        ("/log", "protobuf", "foxglove.Log", "protobuf", b"\n\xb8\xff\x01"),
        ("/rear/image", "json", "sensor_msgs/msg/Image", "jsonschema", "{}"),
        ("/lidar/points", "json", "sensor_msgs/msg/PointCloud2", "jsonschema", "{}"),
        ("/cam/image_rect", "cdr", "sensor_msgs/msg/CompressedImage", "ros2msg", ""),
        ("/flat", "flatbuffer", "x", "of tomorrow", b"\xff"),
    ]
    path = write_mcap(tmp_path / "a.mcap", record("mcap"), others)
    left_out = {f"{topic} ({encoding} {kind})": 1 for topic, encoding, kind, *_ in others}
    assert frames_of(path) == (N, left_out)
    path = write_mcap(tmp_path / "b.mcap", record("mcap"), [])
    assert frames_of(path) == (N, {})
    path.write_bytes(path.read_bytes().replace(b"ros2", b"ros1", 1))
    with pytest.raises(InputError, match="ros2"):
        RosBag(path)


@pytest.mark.parametrize(
    "kind", ["sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Image"]
)
def test_a_damaged_message_is_left_out(record, kind):
    """The damaged message comes before the first good one, which says what the topic holds."""
    bag = record("mcap")
    topic, recorded_ns = next((each[0], each[3]) for each in bag.messages if each[1] == kind)
    bag.messages.insert(0, (topic, kind, b"\0\1\0\0" + bytes(8), recorded_ns - 1))
    path = bag.write()
    with BagSource(path) as source:
        frames = source.list_frames()
        assert source.inputs["left_out"] == {f"{topic} (damaged)": 1}
        assert source.read(frames[-1]).sparse_depth.any()


def test_a_transform_that_is_not_used_may_be_invalid(record):
    bag = record("ros2")
    bag.static_transform("base", "gripper", (0.0, 0.0, 0.0, 0.0), (0, 0, 0))
    assert frames_of(bag.write()) == (N, {})
    bag.static_transform("base", "lidar", (0.0, 0.0, 0.0, 0.0), (0, 0, 0))
    with pytest.raises(InputError, match="base to lidar"):
        frames_of(bag.write("used"))


def test_an_invalid_pose_is_left_out(record):
    """The first one of a filter that has not started."""
    bag = record("ros2")
    for index in range(-1, N + 1):
        turn = (0, 0, 0, 0) if index < 0 else (0, 0, 0, 1)
        stamp_ns = START_NS + 100 * MS * index
        bag.odometry("/odom", (float(index), 0.0, 0.0), stamp_ns, turn=turn)
    with BagSource(bag.write()) as source:
        frames = source.list_frames()
        assert source.inputs["left_out"] == {"/odom (damaged)": 1}
        assert source.inputs["pose_topic"] == "/odom"
        assert source.read(frames[2]).depth_motion == "scan"


def test_a_topic_of_damaged_images_does_not_spoil_the_others(record):
    bag = record("ros2")
    bag.messages += [
        ("/rear/image", "sensor_msgs/msg/Image", b"\0\1\0\0" + bytes(8), START_NS + index)
        for index in range(3)
    ]
    assert frames_of(bag.write()) == (N, {"/rear/image (damaged)": 3})
