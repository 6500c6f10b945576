"""Bags of ROS 1 and ROS 2 and MCAP files, written by rosbags, through ssdnet-run."""

import builtins
import contextlib
import os
import sqlite3
import struct

import cv2
import numpy as np
import pytest
from small_rig import INTRINSICS, MS, OPTICAL, SIZE, START_NS, add_tree, projected

import runtime.sources.ros_bag
from runtime import InputError
from runtime.sources.bag import BagSource

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")


KINDS = ("ros1", "ros2", "mcap")
N = 6


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def add_camera(bag, make_frame, *, topic="/cam/image_rect", n=N, encoding="rgb8"):
    for index in range(n):
        rgb, _ = make_frame(*SIZE, seed=index)
        image = rgb[..., ::-1] if encoding == "bgr8" else rgb
        bag.image(topic, image, encoding, START_NS + 100 * MS * index)
    bag.info("/cam/camera_info", INTRINSICS, SIZE)


def add_lidar(bag, make_scan, *, n=N, late_ms=7):
    for index in range(n):
        bag.cloud("/lidar/points", make_scan(index), START_NS + (100 * index + late_ms) * MS)


@pytest.fixture
def recorded(make_bag, make_frame, make_scan, kind):
    """The path of a bag of N images and N scans."""
    bag = make_bag(kind)
    add_camera(bag, make_frame)
    add_lidar(bag, make_scan)
    add_tree(bag)
    return bag.write()


def name_of(index):
    return str(START_NS + 100 * MS * index)


def test_a_bag_from_end_to_end(recorded, run, make_scan):
    answers = run(recorded)
    assert answers.exit_code == 0, answers.text
    assert answers.names == [name_of(index) for index in range(N)]
    for index in range(N):
        expected = projected(make_scan(index), ahead_m=0.5)
        assert np.count_nonzero(expected) > 100
        assert abs(answers.fed_depth(name_of(index)) - expected).max() < 0.01
    assert "topics: image_topic=/cam/image_rect, depth_topic=/lidar/points" in answers.text
    for row, index in zip(answers.rows, range(N), strict=True):
        assert int(row["image_stamp_ns"]) == START_NS + 100 * MS * index
        assert int(row["depth_stamp_ns"]) == START_NS + (100 * index + 7) * MS
    inputs = answers.report["inputs"]
    assert (inputs["image_topic"], inputs["info_topic"]) == ("/cam/image_rect", "/cam/camera_info")
    assert (inputs["focal_length_px"], inputs["left_out"]) == (60, {})


def test_the_pictures_are_those_that_were_recorded(recorded, make_frame):
    with BagSource(recorded) as source:
        frames = source.list_frames()
        for index in (0, 0, 3, 1, 5):  # also again, and back
            frame = source.read(frames[index])
            assert np.array_equal(frame.rgb, make_frame(*SIZE, seed=index)[0])
            assert np.count_nonzero(frame.sparse_depth) > 100


@pytest.mark.parametrize(
    ("encoding", "dtype", "units", "big"),
    [("16UC1", "<u2", 1000, 0), ("16UC1", ">u2", 1000, 1), ("32FC1", ">f4", 1, 1)],
)
def test_depth_images_are_metres(make_bag, make_frame, kind, encoding, dtype, units, big):
    bag = make_bag(kind)
    add_camera(bag, make_frame)
    depth = make_frame(*SIZE)[1] * 0.8  # 65 m are 16 bits
    values = (np.rint(depth * units) if units > 1 else depth).astype(dtype)
    bag.image("/depth", values, encoding, START_NS + 3 * MS, is_bigendian=big)
    with BagSource(bag.write()) as source:
        frame = source.read(source.list_frames()[0])
        assert source.calibration.focal_length_px == 60
    np.testing.assert_allclose(frame.sparse_depth, depth, atol=1e-3)


def test_the_order_of_recording_does_not_matter(make_bag, make_frame, make_scan):
    """Scans are recorded 300 ms after they were taken, pictures at once."""
    bag = make_bag("ros2")
    add_camera(bag, make_frame, n=20)
    for index in range(20):
        stamp_ns = START_NS + (100 * index + 7) * MS
        bag.cloud("/lidar/points", make_scan(index), stamp_ns, recorded_ns=stamp_ns + 300 * MS)
    add_tree(bag)
    with BagSource(bag.write()) as source:
        frames = source.list_frames()
        assert [f.depth_stamp_ns - f.image_stamp_ns for f in frames] == [7 * MS] * 20
        for index in (*range(10), 13, 16, 19):  # as a part of the whole passes frames over
            read = source.read(frames[index])
            assert abs(read.sparse_depth - projected(make_scan(index), ahead_m=0.5)).max() < 0.001


def test_messages_without_a_stamp_have_the_time_of_recording(make_bag, make_frame):
    bag = make_bag("ros1")
    for index in range(3):
        rgb, _ = make_frame(*SIZE, seed=index)
        bag.image("/cam", rgb, "rgb8", 0, recorded_ns=START_NS + index)
    with BagSource(bag.write(), depth_topic="none") as source:
        assert [f.image_stamp_ns for f in source.list_frames()] == [START_NS + i for i in range(3)]


def test_a_recording_of_a_loop_answers_every_turn(make_bag, make_frame):
    bag = make_bag("mcap")
    grey = make_frame(*SIZE)[0][..., 0]
    for turn in range(2):
        for index in range(80):
            stamp_ns = START_NS + 100 * MS * index
            recorded_ns = START_NS + 100 * MS * (index + 80 * turn)
            bag.image("/cam", grey, "mono8", stamp_ns, recorded_ns=recorded_ns)
    with BagSource(bag.write(), depth_topic="none") as source:
        names = [frame.name for frame in source.list_frames()]
    assert len(set(names)) == 160
    assert names[80] == f"{names[0]}-2"


def test_no_output_takes_the_place_of_a_bag_that_is_read(make_bag, make_frame, run):
    bag = make_bag("mcap")
    add_camera(bag, make_frame)
    file = bag.write()
    before = file.read_bytes()
    for path in (file, file.parent):  # the file alone, and the folder that holds it
        source = ["--source", f"bag:{path},depth_topic=none"]
        answers = run(*source, "--mcap", file, "--overwrite")
        assert answers.exit_code == 1
        assert f"{file} is what the run reads: choose another name" in answers.text
        assert file.read_bytes() == before


def test_a_raw_topic_is_preferred_to_the_same_compressed(make_bag, make_frame, kind):
    bag = make_bag(kind)
    add_camera(bag, make_frame, n=1)
    rgb, _ = make_frame(*SIZE, seed=1)
    png = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
    packed = "/cam/image_rect/compressed"
    bag.compressed(packed, png, "rgb8; png compressed bgr8", START_NS)
    path = bag.write()
    with BagSource(path, depth_topic="none") as source:
        assert source.inputs["image_topic"] == "/cam/image_rect"
    with BagSource(path, depth_topic="none", image_topic=packed) as source:
        np.testing.assert_array_equal(source.read(source.list_frames()[0]).rgb, rgb)


def test_topics_that_cannot_be_guessed_are_listed(make_bag, make_frame, make_scan):
    bag = make_bag("mcap")
    for topic in ("/cam/image_rect", "/rear/image_rect"):
        add_camera(bag, make_frame, topic=topic, n=2)
    add_lidar(bag, make_scan, n=2)
    add_tree(bag)
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


def test_a_bag_without_pictures_or_depth_says_what_it_has(make_bag, make_frame, make_scan):
    bag = make_bag("ros1")
    add_lidar(bag, make_scan)
    with pytest.raises(InputError, match="/lidar/points"):
        BagSource(bag.write("blind"))
    bag = make_bag("ros1")
    add_camera(bag, make_frame)
    with pytest.raises(InputError, match="depth_topic=none"):
        BagSource(bag.write("flat"))


def test_clouds_need_a_calibration_and_take_a_file(make_bag, make_frame, make_scan, tmp_path):
    bag = make_bag("ros2")
    add_camera(bag, make_frame, n=1)
    add_lidar(bag, make_scan, n=1)
    bag.static_transform("base", "camera", OPTICAL, (0, 0, 0))
    path, own = bag.write(), tmp_path / "own.toml"
    (tmp_path / "camera.txt").write_text("60 0 32 0 60 24 0 0 1")
    extrinsics = [[0, -1.0, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, -0.5], [0, 0, 0, 1]]
    own.write_text(f"intrinsics = {INTRINSICS}\nextrinsics = {extrinsics}\n")
    for options in ({}, {"calibration": tmp_path / "camera.txt"}):
        with pytest.raises(InputError, match=r"lidar|intrinsics alone"):
            BagSource(path, **options)
    with BagSource(path, calibration=own) as source:
        depth = source.read(source.list_frames()[0]).sparse_depth
    assert abs(depth - projected(make_scan(0), ahead_m=0.5)).max() < 0.01


def test_scans_are_projected_into_rectified_images(make_bag, make_frame, make_scan):
    bag = make_bag("mcap")
    add_camera(bag, make_frame, topic="/raw/image_raw", n=1)
    bag.info("/raw/camera_info", INTRINSICS, SIZE, distortion=(0.1, -0.02, 0.01, 0.02, 0))
    add_lidar(bag, make_scan, n=1)
    add_tree(bag)
    with BagSource(bag.write(), info_topic="/raw/camera_info") as source:
        expected = source.calibration.rectified.project(make_scan(0), SIZE)
        source.rectify_images()
        depth = source.read(source.list_frames()[0]).sparse_depth
    np.testing.assert_array_equal(depth, expected)


def test_a_broken_message_is_a_frame_that_is_skipped(make_bag, make_frame, make_scan, run, kind):
    bag = make_bag(kind)
    add_camera(bag, make_frame)
    add_lidar(bag, make_scan)
    add_tree(bag)
    scans = [i for i, message in enumerate(bag.messages) if message[0] == "/lidar/points"]
    images = [i for i, message in enumerate(bag.messages) if message[0] == "/cam/image_rect"]
    for index, keep in ((images[1], 40), (scans[2], 60), (scans[4], -30), (images[5], 3)):
        topic, type_name, raw, recorded_ns = bag.messages[index]
        bag.messages[index] = (topic, type_name, raw[:keep], recorded_ns)
    answers = run("--source", f"bag:{bag.write()}")
    assert answers.exit_code == 3, answers.text
    assert answers.names == [name_of(index) for index in range(N - 1)]
    assert answers.column("status") == ["ok", "skipped", "skipped", "ok", "skipped"]
    reasons = answers.column("reason")
    assert "message of /cam/image_rect" in reasons[1]
    assert "message of /lidar/points" in reasons[2]
    assert answers.report["inputs"]["left_out"] == {"image: bad_stamp": 1, "depth: no_image": 1}


def test_a_bag_without_definitions_is_read_by_those_of_ros_2(make_bag, make_frame):
    """As before ROS 2 Iron."""
    bag = make_bag("ros2")
    add_camera(bag, make_frame)
    path = bag.write()
    with contextlib.closing(sqlite3.connect(next(path.glob("*.db3")))) as connection, connection:
        connection.execute("DELETE FROM message_definitions")
    with BagSource(path, depth_topic="none") as source:
        assert len(source.list_frames()) == N


@pytest.mark.parametrize("name", ["empty.bag", "text.mcap", "folder", "drive.db3"])
def test_what_is_no_bag_is_an_error(tmp_path, name):
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"" if name == "empty.bag" else b"no bag" * 100)
    with pytest.raises(InputError, match=name):
        BagSource(path)


@pytest.fixture(params=KINDS)
def small(request, make_bag, make_frame, make_scan):
    """(the path of a bag of two frames, its only file, what that holds)."""
    bag = make_bag(request.param)
    add_camera(bag, make_frame, n=2)
    add_lidar(bag, make_scan, n=2)
    add_tree(bag)
    path = bag.write("small")
    (file,) = path.glob("*.db3") if path.is_dir() else (path,)
    return path, file, file.read_bytes()


def test_a_bag_that_is_damaged_anywhere_is_frames_or_an_input_error(small):
    """40 cuts and 40 files of a few wrong bytes each."""
    path, file, content = small
    random = np.random.default_rng(0)
    outcomes = set()
    for turn in range(80):
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


@pytest.mark.parametrize("name", ["metadata.yaml", "small-ros2.db3"])
def test_a_pipe_in_a_bag_is_not_waited_for(make_bag, make_frame, name):
    bag = make_bag("ros2")
    add_camera(bag, make_frame, n=2)
    path = bag.write("small")
    (path / name).unlink()
    os.mkfifo(path / name)
    with pytest.raises(InputError, match="not a regular file"):
        BagSource(path)


@pytest.mark.parametrize(
    ("error", "remedy"),
    [(ImportError("undefined symbol"), "cannot be loaded"), (ModuleNotFoundError(), "pip install")],
)
def test_rosbags_that_cannot_be_imported_is_not_a_damaged_bag(
    make_bag, make_frame, monkeypatch, error, remedy
):
    bag = make_bag("mcap")
    add_camera(bag, make_frame, n=2)
    path, real = bag.write(), builtins.__import__

    def fail(name, *arguments):
        if name == "rosbags.typesys":
            raise error
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(InputError, match=remedy):
        BagSource(path)


PACKED = [("ros1", "bz2"), ("ros1", "lz4"), ("ros2", "message"), ("mcap", "storage")]


@pytest.mark.parametrize(("kind", "compression"), PACKED)
def test_a_compressed_bag_is_read_up_to_a_declared_size(
    make_bag, make_frame, make_scan, monkeypatch, kind, compression
):
    bag = make_bag(kind)
    add_camera(bag, make_frame)
    add_lidar(bag, make_scan)
    add_tree(bag)
    path = bag.write(compression=compression)
    with BagSource(path) as source:
        frames = [source.read(frame) for frame in source.list_frames()]
        assert np.array_equal(frames[3].rgb, make_frame(*SIZE, seed=3)[0])
        assert len(frames) == N
        assert not source.inputs["left_out"]
    if compression == "message":
        return  # no size is declared before the message itself
    monkeypatch.setattr(runtime.sources.ros_bag, "MAX_CHUNK_BYTES", 1000)
    with pytest.raises(InputError, match="1,000"):
        BagSource(path)


def test_messages_that_the_index_promises_and_the_bag_has_lost_are_counted(make_bag, make_frame):
    """A part of the data is zeroed, as a failing disk leaves it."""
    bag = make_bag("mcap")
    for index in range(200):  # several chunks
        rgb, _ = make_frame(*SIZE, seed=index)
        bag.image("/cam/image_rect", rgb, "rgb8", START_NS + 100 * MS * index)
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
