"""Bags of ROS 1 and ROS 2 and MCAP files, written by rosbags: what becomes a frame."""

import builtins
import struct

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.recordings.bag import BagSource
from small_rig import INTRINSICS, MS, SIZE, START_NS, add_tree, projected

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

KINDS = ("ros1", "ros2", "mcap")
N = 6


def name_of(index):
    return str(START_NS + 100 * MS * index)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_from_end_to_end(record, run, make_scan, kind):
    answers = run(record(kind, images=N, scans=N).write())
    answers.require({name_of(n): projected(make_scan(n), ahead_m=0.5) for n in range(N)})
    for index, row in enumerate(answers.rows):
        assert int(row["image_stamp_ns"]) == START_NS + 100 * MS * index
        assert int(row["depth_stamp_ns"]) == START_NS + (100 * index + 7) * MS
    assert "topics: image_topic=/cam/image_rect, depth_topic=/lidar/points" in answers.text
    inputs = answers.report["inputs"]
    assert (inputs["image_topic"], inputs["info_topic"]) == ("/cam/image_rect", "/cam/camera_info")
    assert (inputs["focal_length_px"], inputs["left_out"]) == (60, {})


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_read_again_and_back(record, make_frame, kind):
    path = record(kind, images=N, scans=N).write()
    with BagSource(path) as source:
        assert source.recordings == (path,), "outputs do not take its place"
        frames = source.list_frames()
        for index in (0, 0, 3, 1, 5):
            frame = source.read(frames[index])
            assert np.array_equal(frame.rgb, make_frame(*SIZE, seed=index)[0])
            assert np.count_nonzero(frame.sparse_depth) > 100
        (first, *_) = source.list_frames(limit=2)
        assert np.array_equal(source.read(first).rgb, make_frame(*SIZE)[0])


@pytest.mark.parametrize("stamps_ns", [(0, 0, 0), (0, 1, 2)])
def test_messages_without_a_stamp_have_the_time_of_recording(record, make_frame, stamps_ns):
    """Beside scans this is said, unless only the first stamp is 0, as of a simulator."""
    bag = record("ros1", images=0)
    for index, stamp_ns in enumerate(stamps_ns):
        rgb, _ = make_frame(*SIZE, seed=index)
        bag.image("/cam/image_rect", rgb, "rgb8", stamp_ns, recorded_ns=START_NS + index)
    with BagSource(bag.write()) as source:
        times_ns = [frame.image_stamp_ns for frame in source.list_frames()]
        said = [note for note in source.notes if "have no stamps" in note]
    if any(stamps_ns):
        assert sorted(times_ns) == [1, 2, START_NS]
        assert not said
    else:
        assert times_ns == [START_NS + index for index in range(3)]
        assert "messages of /cam/image_rect" in said[0]


def test_an_mcap_file_needs_no_index_of_its_messages(record):
    """The offsets of the indexes of messages are removed from the indexes of the chunks."""
    path = record().write()
    content = path.read_bytes()
    (at,), changed = struct.unpack_from("<Q", content, len(content) - 28), b""
    whole = content[:at]
    while content[at] != 0x02:  # records: a byte, the length, and the content
        code, size = struct.unpack_from("<BQ", content, at)
        body = content[at + 9 : at + 9 + size]
        if code == 0x08:
            body = body[:32] + bytes(4) + body[36 + struct.unpack_from("<I", body, 32)[0] :]
            changed += body
        whole += struct.pack("<BQ", code, len(body)) + body
        at += 9 + size
    assert changed
    path.write_bytes(whole + content[at:])
    with BagSource(path) as source:
        frames = [source.read(frame) for frame in source.list_frames()]
    assert len(frames) == 4
    assert all(frame.sparse_depth.any() for frame in frames)


@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_poses_that_stay_although_the_twist_moves_are_no_poses(record, speed):
    bag = record()
    for index in range(-5, 20):
        bag.odometry("/odom", (0, 0, 0), START_NS + 50 * MS * index, speed=(speed, 0, 0))
    with BagSource(bag.write()) as source:
        assert (source.inputs["pose_topic"] == "/odom") == (speed == 0)
        assert any("does not move" in note for note in source.notes) == (speed > 0)


def test_a_recording_of_a_loop_answers_every_turn(make_bag, make_frame):
    bag = make_bag()
    grey = make_frame(*SIZE)[0][..., 0]
    for turn in range(2):
        for index in range(80):
            stamp_ns = START_NS + 100 * MS * index
            bag.image("/cam", grey, "mono8", stamp_ns, recorded_ns=stamp_ns + 8000 * MS * turn)
    with BagSource(bag.write(), depth_topic="none") as source:
        frames = source.list_frames()
    assert all(frame.complete for frame in frames), "the camera alone"
    names = [frame.name for frame in frames]
    assert len(set(names)) == 160
    assert names[80] == f"{names[0]}-2"


@pytest.mark.parametrize("kind", KINDS)
def test_topics_that_were_written_one_after_the_other_are_matched(make_bag, make_scan, kind):
    bag, count, image = make_bag(kind), 300, np.zeros((*SIZE, 3), np.uint8)
    for index in range(count):  # stamps of the sensors, recorded by a converter
        stamp_ns, at = START_NS + 100 * MS * index, START_NS + index
        bag.image("/cam/image_rect", image + index % 250, "rgb8", stamp_ns, recorded_ns=at)
        bag.cloud("/lidar/points", make_scan(index), stamp_ns, recorded_ns=at + count)
    bag.info("/cam/camera_info", INTRINSICS, SIZE)
    add_tree(bag)
    with BagSource(bag.write()) as source:
        frames = source.list_frames(limit=2)
        assert [each.depth_stamp_ns for each in frames] == [START_NS, START_NS + 100 * MS]
        frames = source.list_frames()
        assert all(each.complete for each in frames)
        assert len(frames) == count
        for index in (0, 7, 299, 7):
            frame = source.read(frames[index])
            assert (frame.rgb == index % 250).all()
            assert np.array_equal(frame.scan.points[:, 0], make_scan(index)[:, 0])


def test_a_raw_topic_is_preferred_to_the_same_compressed(record, make_frame):
    bag = record(images=1, scans=0)
    rgb, _ = make_frame(*SIZE, seed=1)
    png = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
    packed = "/cam/image_rect/compressed"
    bag.compressed(packed, png, "rgb8; png compressed bgr8", START_NS)
    path = bag.write()
    with BagSource(path, depth_topic="none") as source:
        assert source.inputs["image_topic"] == "/cam/image_rect"
    with BagSource(path, depth_topic="none", image_topic=packed) as source:
        np.testing.assert_array_equal(source.read(source.list_frames()[0]).rgb, rgb)


def test_topics_that_cannot_be_guessed_are_listed(record, make_frame):
    bag = record(images=2, scans=2)
    for index in range(2):
        bag.image("/rear/image_rect", make_frame(*SIZE)[0], "rgb8", START_NS + 100 * MS * index)
    path, rear = bag.write(), {"image_topic": "/rear/image_rect"}
    for options, named in (
        ({}, "/rear/image_rect"),
        ({"image_topic": "/nowhere"}, "image_topic=/nowhere"),
        (rear, "CameraInfo"),
        (rear | {"info_topic": "/none"}, "info_topic=/none"),
    ):
        with pytest.raises(InputError, match=named):
            BagSource(path, **options)
    for options in ({"image_topic": "/cam/image_rect"}, rear | {"info_topic": "/cam/camera_info"}):
        with BagSource(path, **options) as source:
            assert len(source.list_frames()) == 2
    for name, counts, named in (("a", (0, 2), "/lidar/points"), ("b", (2, 0), "depth_topic=none")):
        images, scans = counts
        with pytest.raises(InputError, match=named):
            BagSource(record(images=images, scans=scans).write(name))


@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_message_costs_its_frame(record, kind):
    bag = record(kind, images=N, scans=N)
    scans = [i for i, message in enumerate(bag.messages) if message[0] == "/lidar/points"]
    images = [i for i, message in enumerate(bag.messages) if message[0] == "/cam/image_rect"]
    for index, keep in ((images[1], 40), (scans[2], 60), (scans[4], -30), (images[5], 3)):
        topic, type_name, raw, recorded_ns = bag.messages[index]
        bag.messages[index] = (topic, type_name, raw[:keep], recorded_ns)
    with BagSource(bag.write()) as source:
        frames = source.list_frames()
        assert [each.name for each in frames] == [name_of(index) for index in range(N - 1)]
        for index, topic in ((1, "/cam/image_rect"), (2, "/lidar/points"), (4, "/lidar/points")):
            with pytest.raises(InputError, match=f"message of {topic}"):
                source.read(frames[index])
        assert [source.read(frames[index]).sparse_depth.any() for index in (0, 3)] == [True, True]
        assert source.inputs["left_out"] == {"image: bad_stamp": 1, "depth: no_image": 1}


@pytest.mark.parametrize("name", ["empty.bag", "text.mcap", "folder", "drive.db3"])
def test_what_is_no_bag_is_an_error(tmp_path, name):
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"" if name == "empty.bag" else b"no bag" * 100)
    with pytest.raises(InputError, match=name):
        BagSource(path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_that_is_damaged_anywhere_is_frames_or_an_input_error(record, kind):
    """12 cuts and 12 files of a few wrong bytes each."""
    path = record(kind, images=2, scans=2).write()
    (file,) = path.glob("*.db3") if path.is_dir() else (path,)
    content, random = file.read_bytes(), np.random.default_rng(0)
    outcomes = set()
    for turn in range(24):
        damaged = np.frombuffer(content, np.uint8).copy()
        if turn % 2:
            damaged = damaged[: random.integers(len(damaged))]
        else:
            damaged[random.integers(len(damaged), size=turn)] = random.integers(256, size=turn)
        file.write_bytes(damaged.tobytes())
        try:
            with BagSource(path) as source:
                for frame in source.list_frames():
                    source.read(frame)
            outcomes.add("frames")
        except InputError:
            outcomes.add("input error")
    assert outcomes == {"frames", "input error"}


@pytest.mark.parametrize(("error", "remedy"), [
    (ImportError("undefined symbol"), "cannot be loaded"), (ModuleNotFoundError(), "pip install"),
])  # fmt: skip
def test_rosbags_that_cannot_be_imported_is_not_a_damaged_bag(record, monkeypatch, error, remedy):
    path, real = record().write(), builtins.__import__

    def fail(name, *arguments):
        if name == "rosbags.typesys":
            raise error
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(InputError, match=remedy):
        BagSource(path)
