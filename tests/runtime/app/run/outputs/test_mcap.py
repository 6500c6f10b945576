"""The MCAP file holds every answer as standard messages, and is whole or not there."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

from runtime import Calibration, OutputError, Predictor
from runtime.app.run.outputs.mcap import open_mcap
from runtime.drawing.overlay import Overlay
from runtime.recordings.ros_answers import FixedTransform, SensorFrames
from runtime.streams.frame import Frame
from runtime.streams.messages import Image

rosbags = pytest.importorskip("rosbags", reason="the extra bag is not installed")

from rosbags.highlevel import AnyReader  # noqa: E402

STAMP_NS = 1_317_046_451_072_943_872
# Head -> format of its images, and largest difference after them.
HEADS = {
    "semantic": ("mono8; png compressed", 0),
    "depth": ("16UC1; png compressed", 0.5 / 256),
    "depth_uncertainty": ("16UC1; png compressed", 0.5 / 256),
    "boundary": ("mono8; jpeg compressed", 0.1),
}
CAMERA = Calibration(
    np.array([[60.0, 0, 40], [0, 61, 30], [0, 0, 1]]), np.eye(4), lens="plumb_bob",
    distortion=[-0.1, 0.01, 0, 0, 0],
)  # fmt: skip
FIELDS = {"x": "<f4", "y": "<f4", "z": "<f4", "rgb": "<u4", "class": "u1", "uncertainty": "<f4"}


def read_mcap(path):
    """Topic -> [(time, message)], as rosbags' own reader has them."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_answers_have_the_stamps_of_the_camera(tmp_path, contract, answered, open_run):
    frame, result = answered
    prediction = result.prediction
    path = tmp_path / "deep" / "a.mcap"
    with open_mcap(open_run(mcap=path)) as mcap:
        for number in range(3):
            stamp_ns = STAMP_NS + number * 100_000_000
            stamped = Frame(Image(frame.rgb, stamp_ns=stamp_ns), name=f"f{number}")
            mcap.write(stamped, dataclasses.replace(result, name=stamped.name))
        assert not path.exists()
    topics = read_mcap(path)
    ((_, scales),) = topics["/ssdnet/scales"]
    scales = {"semantic": 1, **json.loads(scales.data)}
    for head, (form, tolerance) in HEADS.items():
        for number, (time_ns, image) in enumerate(topics[f"/ssdnet/{head}/compressed"]):
            stamp = image.header.stamp
            assert time_ns == stamp.sec * 10**9 + stamp.nanosec == STAMP_NS + number * 10**8
            assert image.header.frame_id == "camera"
            assert image.format == form
            values = cv2.imdecode(image.data, cv2.IMREAD_UNCHANGED) / scales[head]
            error = abs(values - getattr(prediction, head)).max()
            assert error <= tolerance * 1.001, head
        assert number == 2
    assert not {"/ssdnet/points", "/ssdnet/camera_info", "/tf_static"} & topics.keys()
    (_, overlay), *_ = topics["/ssdnet/overlay/compressed"]
    drawn = Overlay(contract.classes, contract.max_depth_m).draw(frame.rgb, prediction)
    assert overlay.format == "jpeg"
    assert abs(cv2.imdecode(overlay.data, cv2.IMREAD_COLOR).astype(int) - drawn).mean() < 12
    ((_, classes),) = topics["/ssdnet/classes"]
    assert json.loads(classes.data) == {"0": "dark", "1": "red"}
    (_, diagnostics), *_ = topics["/diagnostics"]
    (status,) = diagnostics.status
    assert (status.name, status.level, status.message) == ("ssdnet", 0, "ok")
    values = {entry.key: entry.value for entry in status.values}
    assert values["frame"] == "f0"
    assert float(values["total_ms"]) == pytest.approx(prediction.latency.total_ms, abs=1e-3)


def test_the_cloud_is_in_the_frame_of_the_recording(tmp_path, answered, open_run):
    frame, result = answered
    seen = Frame(Image(frame.rgb, stamp_ns=STAMP_NS), calibration=CAMERA)
    run = open_run(mcap=tmp_path / "a.mcap", cloud_voxel=0.2, max_uncertainty=0.5)
    lidar = FixedTransform("front_optical", "lidar_top", (1, 2, 3), (0, 0, 0.6, 0.8))
    run.sensors = SensorFrames("front_optical", (lidar,), "/tf_static")
    with open_mcap(run) as mcap:
        mcap.write(seen, result)
    topics = read_mcap(tmp_path / "a.mcap")
    ((time_ns, cloud),) = topics["/ssdnet/points"]
    expected = result.prediction.points(CAMERA, frame.rgb, voxel_m=0.2, max_uncertainty=0.5)
    assert (time_ns, cloud.header.frame_id) == (STAMP_NS, "front_optical")
    layout = {"names": [*FIELDS], "formats": [*FIELDS.values()], "itemsize": cloud.point_step}
    layout["offsets"] = [field.offset for field in cloud.fields]
    assert [field.name for field in cloud.fields] == [*FIELDS]
    assert [field.datatype for field in cloud.fields] == [7, 7, 7, 7, 2, 7]
    assert cloud.point_step == sum(np.dtype(kind).itemsize for kind in FIELDS.values()), "packed"
    points = cloud.data.view(np.dtype(layout))
    assert cloud.width == len(points) == len(expected.points) > 9
    for place, axis in enumerate("xyz"):
        np.testing.assert_array_equal(points[axis], expected.points[:, place])
    for shift, color in zip((16, 8, 0), expected.rgb.T, strict=True):
        np.testing.assert_array_equal(points["rgb"] >> shift & 255, color)
    np.testing.assert_array_equal(points["class"], expected.semantic)
    np.testing.assert_array_equal(points["uncertainty"], expected.uncertainty)
    ((_, info),) = topics["/ssdnet/camera_info"]
    assert (info.height, info.width, info.header) == (60, 80, cloud.header)
    read = Calibration.from_camera_info(vars(info) | {"roi": None}, np.eye(4), rectified=False)
    np.testing.assert_array_equal(read.intrinsics, CAMERA.intrinsics)
    assert (read.lens, [*read.distortion]) == (CAMERA.lens, CAMERA.distortion)
    ((_, static),) = topics["/tf_static"]
    (placed,) = static.transforms
    assert (placed.header.frame_id, placed.child_frame_id) == ("front_optical", "lidar_top")
    assert (placed.transform.translation.z, placed.transform.rotation.w) == (3, 0.8)


def test_what_is_degraded_is_a_warning(tmp_path, answered, model_file, open_run):
    frame, result = answered
    with Predictor(model_file()) as predictor:
        camera_only = predictor.predict(frame.rgb, np.zeros_like(frame.sparse_depth))
    with open_mcap(open_run(mcap=tmp_path / "a.mcap")) as mcap:
        mcap.write(frame, dataclasses.replace(result, prediction=camera_only))
    topics = read_mcap(tmp_path / "a.mcap")
    ((_, diagnostics),) = topics["/diagnostics"]
    assert (diagnostics.status[0].level, diagnostics.status[0].message) == (1, "no_depth")
    assert "/ssdnet/depth_uncertainty/compressed" not in topics, "the model has no such head"


def test_frames_without_stamps_come_at_the_rate(tmp_path, run):
    assert run("--save", "none", "--mcap", tmp_path / "a.mcap", "--rate", 1000).exit_code == 0
    depths = read_mcap(tmp_path / "a.mcap")["/ssdnet/depth/compressed"]
    times_ns = [time_ns for time_ns, _ in depths]
    assert times_ns == [number * 1_000_000 for number in range(len(times_ns))]
    assert len(times_ns) == 12


def test_a_stamp_that_ros_cannot_hold_leaves_no_file(tmp_path, answered, open_run):
    frame, result = answered
    path = tmp_path / "made" / "a.mcap"

    def fail():
        with open_mcap(open_run(mcap=path)) as mcap:
            mcap.write(frame, result)
            mcap.write(Frame(Image(frame.rgb, stamp_ns=2**31 * 10**9)), result)

    with pytest.raises(OutputError, match="has the stamp"):
        fail()
    assert list(path.parent.iterdir()) == []


def test_without_the_extra_the_error_names_what_to_install(tmp_path, monkeypatch, run):
    monkeypatch.setitem(__import__("sys").modules, "rosbags", None)
    result = run("--mcap", tmp_path / "a.mcap")
    assert result.exit_code == 1
    assert 'pip install -c constraints.txt ".[bag]"' in result.stderr
    assert not (tmp_path / "out").exists(), "before anything is written"
