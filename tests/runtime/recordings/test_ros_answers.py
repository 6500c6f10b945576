"""Answers to a bag lie where its own /tf_static has its camera."""

import numpy as np
import pytest

from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from runtime.recordings.bag import BagSource
from runtime.recordings.ros_answers import status_fields
from runtime.recordings.ros_poses import TransformTree
from runtime.streams.stream_counter import WatchdogLevel, WatchdogState
from small_rig import INTRINSICS, MS, OPTICAL, SIZE, START_NS, projected

rosbags = pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

from rosbags.highlevel import AnyReader  # noqa: E402


def test_an_mcap_of_a_bag_has_its_frames_stamps_and_tree(record, run, tmp_path, make_scan):
    path = record(images=2, scans=2).write()
    done = run(path, "--mcap", tmp_path / "a.mcap", "--cloud-voxel", 0.01)
    assert done.exit_code == 0, done.text
    assert "in the frame camera, with /tf_static" in done.text
    found = {}
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        for connection, _, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    with BagSource(path) as source:
        calibration = source.calibration
    tree = TransformTree(found["/tf_static"])
    np.testing.assert_allclose(tree.between("lidar", "camera"), calibration.extrinsics, atol=1e-9)
    for number, cloud in enumerate(found["/ssdnet/points"]):
        stamp = cloud.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == START_NS + 100 * number * MS
        assert cloud.header.frame_id == "camera"
        points = cloud.data.view(np.dtype([("xyz", "<f4", 3), ("rgb", "<f4"), ("class", "u1")]))[
            "xyz"
        ]
        info = found["/ssdnet/camera_info"][number]
        u, v, _ = (info.k.reshape(3, 3) @ (points / points[:, 2:]).T).round().astype(int)
        answer = done.fed_depth(f"{START_NS + 100 * number * MS}") + 1.5
        assert abs(points[:, 2] - answer[v, u]).max() < 1 / 256
    assert number == 1
    assert np.count_nonzero(projected(make_scan(1), ahead_m=0.5)) > 100


def test_the_second_camera_of_a_pair_has_a_frame_beside_the_first(record):
    """The P of the second holds the baseline, and its images are in the frame of the first."""
    bag = record(images=1, scans=1)
    first = bag.write()
    bag.messages = [each for each in bag.messages if each[0] != "/cam/camera_info"]
    bag.info("/cam/camera_info", INTRINSICS, SIZE, shift_px=-30.0)  # 0.5 m
    second = bag.write("second")
    with BagSource(first) as source:
        assert source.sensor_frames.camera == "camera"
    with BagSource(second) as source:
        frames, calibration = source.sensor_frames, source.calibration
    added = frames.transforms[-1]
    assert (frames.camera, added.parent, added.child) == ("camera_ssdnet", "camera", frames.camera)
    np.testing.assert_allclose(added.translation, (0.5, 0, 0), atol=1e-9)
    with BagSource(second, Rig(calibration=calibration)) as source:
        assert source.sensor_frames.camera == "camera", "--calibration"


def test_without_a_tree_the_calibration_places_the_lidar(record):
    with BagSource(record(images=1, scans=1).write()) as source:
        extrinsics = source.calibration.extrinsics
    given = Rig(calibration=Calibration(np.array(INTRINSICS), extrinsics))
    with BagSource(record(images=1, scans=1, tree=False).write("bare"), given) as source:
        frames = source.sensor_frames
    assert (frames.camera, frames.origin) == ("camera", "the calibration")
    ((parent, child, shift, turn),) = frames.transforms
    assert (parent, child) == ("camera", "lidar")
    np.testing.assert_allclose(shift, extrinsics[:3, 3], atol=1e-9)
    np.testing.assert_allclose(np.abs(turn), np.abs(OPTICAL), atol=1e-9)


def test_a_status_is_the_worst_of_answer_and_stream():
    assert status_fields() == {"level": 0, "message": "ok", "values": {}}
    late = WatchdogState(WatchdogLevel.ERROR, ("late",))
    status = status_fields(None, late)
    assert status == {"level": 2, "message": "late", "values": {"state": "ERROR"}}
