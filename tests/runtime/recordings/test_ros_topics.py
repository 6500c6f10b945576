"""What the topics of a bag are: by their names, by their encodings, and by the frames they name."""

import numpy as np
import pytest

from runtime import InputError, Rig
from runtime.geometry.calibration import Calibration
from runtime.recordings.bag import BagSource
from runtime.recordings.ros_topics import Role, role_of
from small_rig import INTRINSICS, MS, SIZE, START_NS, add_tree, projected

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, -0.5], [0, 0, 0, 1]])
CAR = Rig(calibration=Calibration(np.array(INTRINSICS), TO_CAMERA))


@pytest.mark.parametrize(("topic", "encoding", "role"), [
    ("/camera/depth/image_rect_raw", "16UC1", Role.DEPTH),
    ("/camera/aligned_depth_to_color/image_raw", "32FC1", Role.DEPTH),
    ("/thermal_rig/depth/image", "16UC1", Role.DEPTH),
    ("/first/firmware/image", "16UC1", Role.DEPTH),
    ("/thermal/image_raw", "16UC1", Role.MAYBE_DEPTH),
    ("/flir_boson/image16", "16UC1", Role.MAYBE_DEPTH),
    ("/k4a/ir/image_raw", "16UC1", Role.MAYBE_DEPTH),
    ("/camera/infra1/image_rect_raw", "16UC1", Role.MAYBE_DEPTH),
    ("/stereo/disparity", "32FC1", Role.MAYBE_DEPTH),
    ("/depth/confidence", "16UC1", Role.MAYBE_DEPTH),
    ("/flow/magnitude", "32FC1", Role.MAYBE_DEPTH),
    ("/camera/semantic_ids", "16UC1", Role.MAYBE_DEPTH),
    ("/camera/semantic_ids", "mono8", Role.OTHER_PICTURE),
    ("/os_node/nearir_image", "mono16", Role.MAYBE_DEPTH),
    ("/camera/depth/image", "mono16", Role.MAYBE_DEPTH),
    ("/camera/color/image_raw", "rgb8", Role.PICTURE),
    ("/camera/infra2/image_rect_raw", "mono8", Role.OTHER_PICTURE),
    ("/Thermal/image/compressed", "", Role.OTHER_PICTURE),
])  # fmt: skip
def test_a_topic_is_by_its_name_and_its_encoding(topic, encoding, role):
    assert role_of(topic, encoding) is role


def add_images(bag, topic, image, encoding):
    for index in range(2):
        bag.image(topic, image, encoding, START_NS + 100 * MS * index)


def test_infrared_is_neither_depth_nor_the_camera_beside_one(record):
    bag = record(images=2, scans=0)
    counts = np.full(SIZE, 7400, np.uint16)
    add_images(bag, "/thermal/image_raw", counts, "16UC1")
    add_images(bag, "/cam/infra1/image_rect", np.zeros(SIZE, np.uint8), "mono8")
    path = bag.write()
    with BagSource(path) as source:
        frame = source.read(source.list_frames()[0])
        assert source.inputs["image_topic"] == "/cam/image_rect"
        assert not frame.sparse_depth.any()
        assert any("camera alone, since /thermal/image_raw" in note for note in source.notes)
    with BagSource(path, depth_topic="/thermal/image_raw") as source:
        frame = source.read(source.list_frames()[0])
        np.testing.assert_allclose(frame.sparse_depth, 7.4)


def test_infrared_is_the_camera_where_there_is_no_other(make_bag, record):
    bag = make_bag()
    add_images(bag, "/cam/infra1/image_rect", np.full(SIZE, 9, np.uint8), "mono8")
    with BagSource(bag.write(), depth_topic="none") as source:
        assert (source.read(source.list_frames()[0]).rgb == 9).all()


def test_clouds_are_the_depth_beside_a_thermal_camera(record):
    bag = record(images=2, scans=2)
    add_images(bag, "/thermal/image_raw", np.full(SIZE, 7400, np.uint16), "16UC1")
    with BagSource(bag.write()) as source:
        assert source.inputs["depth_topic"] == "/lidar/points"
        assert not any("warning" in note for note in source.notes)


def test_depth_in_mono16_is_read_where_it_is_named(record):
    bag = record(images=2, scans=0)
    add_images(bag, "/depth/image", np.full(SIZE, 2500, np.uint16), "mono16")
    path = bag.write()
    with BagSource(path, depth_topic="/depth/image") as source:
        np.testing.assert_allclose(source.read(source.list_frames()[0]).sparse_depth, 2.5)
    with pytest.raises(InputError, match="/depth/image"):
        BagSource(path, depth_topic="/depths/image")


def two_lidars(record, make_scan, frames, *, tree=True):
    """The scans of two LiDARs on one topic; the second sees from 0.4 m to the left of the first."""
    bag = record(images=4, scans=0, tree=False)
    if tree:
        add_tree(bag)
        bag.static_transform("lidar", "left", (0, 0, 0, 1), (0, 0.4, 0))
    for index, frame in enumerate(frames):
        scan = make_scan(index)
        if frame == "left":
            scan[:, 1] -= 0.4
        bag.cloud("/lidar/points", scan, START_NS + 100 * index * MS, frame_id=frame)
    return bag


def require_right(source, make_scan):
    for index, listed in enumerate(source.list_frames()):
        expected = projected(make_scan(index), ahead_m=0.5)
        np.testing.assert_allclose(source.read(listed).sparse_depth, expected, atol=1e-3)


def test_each_scan_is_projected_by_its_own_frame(record, make_scan):
    path = two_lidars(record, make_scan, ["lidar", "left", "/lidar", "left"]).write()
    with BagSource(path) as source:
        require_right(source, make_scan)
    with BagSource(path, CAR) as source:  # of the first frame
        require_right(source, make_scan)


def test_each_scan_is_moved_by_the_mount_of_its_own_frame(record, make_scan):
    """The base turns about itself by 0.1 rad between each scan and its image, 50 ms later."""
    bag = two_lidars(record, make_scan, [])
    for index, frame in enumerate(("lidar", "left")):
        scan = make_scan(0) - np.float32([0, 0.4 * index, 0, 0])
        bag.cloud("/lidar/points", scan, START_NS + (100 * index - 50) * MS, frame_id=frame)
    for index in range(-4, 8):
        angle = 0.05 * index
        turn = (0, 0, np.sin(angle / 2), np.cos(angle / 2))
        bag.odometry("/odom", (0, 0, 0), START_NS + 25 * MS * index, turn=turn)
    with BagSource(bag.write()) as source:
        first, second = (source.read(f).sparse_depth for f in source.list_frames(limit=2))
        assert source.inputs["pose_topic"] == "/odom"
    assert not np.allclose(first, projected(make_scan(0), ahead_m=0.5), atol=0.1), "moved"
    np.testing.assert_allclose(first, second, atol=1e-3)


@pytest.mark.parametrize("frame", ["rear", ""])
def test_a_scan_of_a_frame_that_is_not_known_is_refused_alone(record, make_scan, frame):
    path = two_lidars(record, make_scan, ["lidar", frame]).write()
    with BagSource(path) as source:
        first, second, *_ = source.list_frames()
        assert source.read(first).sparse_depth.any()
        with pytest.raises(InputError, match=f"frame '{frame}', the first of 'lidar'"):
            source.read(second)


def test_scans_without_a_frame_need_a_calibration(record, make_scan):
    path = two_lidars(record, make_scan, ["", ""]).write()
    with pytest.raises(InputError, match="name no frame: give `calibration="):
        BagSource(path)
    with BagSource(path, CAR) as source:
        assert not any("warning" in note for note in source.notes)


@pytest.mark.parametrize(("frame", "has_odometry", "said"), [
    ("odom", False, True), ("robot/map", False, True), ("start", False, False),
    ("odom", True, True), ("base", True, False),
])  # fmt: skip
def test_scans_of_a_fixed_frame_are_said(record, make_scan, frame, has_odometry, said):
    bag = two_lidars(record, make_scan, [frame, frame], tree=False)
    for index in range(4 * has_odometry):
        bag.odometry("/odom", (index, 0, 0), START_NS + 100 * MS * index)
    with BagSource(bag.write(), CAR) as source:
        notes = [note for note in source.notes if "warning: assumed" in note]
    assert len(notes) == said
    assert all(f"although {frame} is fixed" in note for note in notes)


def test_images_of_two_cameras_on_one_topic_are_refused(record, make_frame):
    bag = record(images=2, scans=2)
    bag.image("/cam/image_rect", make_frame(*SIZE)[0], "rgb8", START_NS + 201 * MS, frame_id="rear")
    with BagSource(bag.write()) as source:
        *others, last = source.list_frames()
        assert [source.read(each).rgb.shape for each in others] == [(*SIZE, 3)] * 2
        with pytest.raises(InputError, match="frame 'rear', the first of 'camera'"):
            source.read(last)


def test_poses_in_two_frames_are_not_used(record, make_scan):
    bag = record(images=4, scans=4)
    for index in range(8):
        for parent in ("odom", "map"):
            stamp_ns = START_NS + 50 * MS * index
            bag.transform(parent, "base", (0, 0, 0, 1), (index, 0, 0), stamp_ns)
    with BagSource(bag.write()) as source:
        assert source.inputs["pose_topic"] is None
        assert any("moves 'base' in 'odom' and in 'map'" in note for note in source.notes)
