"""The MCAP file holds every answer as standard messages, and is whole or not there."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

from runtime import OutputError, Predictor
from runtime.app.drawing.overlay import Overlay
from runtime.app.run.outputs.mcap import open_mcap
from runtime.streams.frame import Frame, Message

rosbags = pytest.importorskip("rosbags", reason="the extra bag is not installed")

from rosbags.highlevel import AnyReader  # noqa: E402

STAMP_NS = 1_317_046_451_072_943_872
HEADS = {"semantic": np.uint8, "depth": np.float32, "depth_uncertainty": np.float32,
         "boundary": np.float32}  # fmt: skip


def read_mcap(path):
    """Topic -> [(time, message)], as rosbags' own reader has them."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_the_answers_are_read_back_with_the_stamps_of_the_camera(
    tmp_path, contract, answered, open_run
):
    frame, result = answered
    prediction = result.prediction
    path = tmp_path / "deep" / "a.mcap"
    with open_mcap(open_run(mcap=path)) as mcap:
        for number in range(3):
            stamp_ns = STAMP_NS + number * 100_000_000
            stamped = Frame(Message(stamp_ns, stamp_ns, frame.rgb), name=f"f{number}")
            mcap.write(stamped, result)
        assert not path.exists()
    topics = read_mcap(path)
    for head, dtype in HEADS.items():
        for number, (time_ns, image) in enumerate(topics[f"/ssdnet/{head}"]):
            stamp = image.header.stamp
            assert time_ns == stamp.sec * 10**9 + stamp.nanosec == STAMP_NS + number * 10**8
            assert image.header.frame_id == "camera"
            assert image.encoding == ("mono8" if head == "semantic" else "32FC1")
            assert image.step * image.height == image.data.size
            values = image.data.view(dtype).reshape(image.height, image.width)
            np.testing.assert_array_equal(values, getattr(prediction, head), strict=True)
        assert number == 2
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


def test_what_is_degraded_is_a_warning(tmp_path, answered, model_file, open_run):
    frame, result = answered
    with Predictor(model_file()) as predictor:
        camera_only = predictor.predict(frame.rgb, np.zeros_like(frame.sparse_depth))
    with open_mcap(open_run(mcap=tmp_path / "a.mcap")) as mcap:
        mcap.write(frame, dataclasses.replace(result, prediction=camera_only))
    topics = read_mcap(tmp_path / "a.mcap")
    ((_, diagnostics),) = topics["/diagnostics"]
    assert (diagnostics.status[0].level, diagnostics.status[0].message) == (1, "no_depth")
    assert "/ssdnet/depth_uncertainty" not in topics, "the model has no such head"


def test_frames_without_stamps_come_at_the_rate(tmp_path, run):
    assert run("--save", "none", "--mcap", tmp_path / "a.mcap", "--rate", 1000).exit_code == 0
    times_ns = [time_ns for time_ns, _ in read_mcap(tmp_path / "a.mcap")["/ssdnet/depth"]]
    assert times_ns == [number * 1_000_000 for number in range(len(times_ns))]
    assert len(times_ns) == 12


def test_a_stamp_that_ros_cannot_hold_leaves_no_file(tmp_path, answered, open_run):
    frame, result = answered
    path = tmp_path / "made" / "a.mcap"

    def fail():
        with open_mcap(open_run(mcap=path)) as mcap:
            mcap.write(frame, result)
            mcap.write(Frame(Message(2.0**31, 2**31 * 10**9, frame.rgb)), result)

    with pytest.raises(OutputError, match="has the stamp"):
        fail()
    assert list(path.parent.iterdir()) == []


def test_without_the_extra_the_error_names_what_to_install(tmp_path, monkeypatch, run):
    monkeypatch.setitem(__import__("sys").modules, "rosbags", None)
    result = run("--mcap", tmp_path / "a.mcap")
    assert result.exit_code == 1
    assert 'pip install -c constraints.txt ".[bag]"' in result.stderr
    assert not (tmp_path / "out").exists(), "before anything is written"
