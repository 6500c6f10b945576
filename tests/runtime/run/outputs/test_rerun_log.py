"""What is logged for Rerun is what was predicted, read back by its own reader."""

import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from collections import defaultdict
from datetime import timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import OutputError
from runtime.run.outputs import rerun_log
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.run.outputs.rerun_log import open_rerun
from runtime.sources.frames import Frame

rerun = pytest.importorskip("rerun", reason="the extra rerun is not installed")


def read_log(path):
    """Entity -> component -> its values, in order; static ones under "static"."""
    logged = defaultdict(lambda: defaultdict(list))
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        name = "static" if chunk.is_static else chunk.entity_path
        for column in batch.schema.names:
            if "RowId" in column or "log_time" in column:
                continue
            component = f"{chunk.entity_path} {column}" if chunk.is_static else column
            logged[name][component] += batch.column(column).to_pylist()
    return logged


@pytest.fixture
def calm(answered):
    """(frame with a smooth picture, prediction)."""
    frame, prediction = answered
    return Frame(np.full_like(frame.rgb, 90), frame.sparse_depth, name="x"), prediction


def test_a_file_holds_what_was_predicted(tmp_path, calm, open_run):
    frame, prediction = calm
    path = tmp_path / "deep" / "a.rrd"
    with open_rerun(open_run(rerun=str(path), focal_length=50.0)) as log:
        for stamp_ns in (1_000_000_000, 2_000_000_000, None):
            stamped = Frame(frame.rgb, frame.sparse_depth, image_stamp_ns=stamp_ns)
            log.write(stamped, prediction)
        assert not path.exists()
    logged = read_log(path)
    classes = [
        (entry["class_id"], entry["class_description"]["info"])
        for (context,) in logged["static"]["/ AnnotationContext:context"]
        for entry in context
    ]
    assert [(number, info["label"], info["color"]) for number, info in classes] == [
        (0, "dark", 0x000080FF),
        (1, "red", 0xC81E1EFF),
    ]
    picture = bytes(logged["/camera/image"]["EncodedImage:blob"][0][0])
    decoded = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR_RGB)
    assert abs(decoded.astype(int) - frame.rgb).max() <= 2
    semantic = bytes(logged["/camera/classes"]["SegmentationImage:buffer"][0][0])
    assert semantic == prediction.semantic.tobytes()
    depth = bytes(logged["/camera/depth"]["DepthImage:buffer"][2][0])
    assert depth == prediction.depth.tobytes()
    assert logged["/camera/depth"]["DepthImage:meter"][0] == [1.0]
    cloud = prediction.points(intrinsics_of(frame, 50.0), frame.rgb)
    points = logged["/cloud"]["Points3D:positions"][1]
    np.testing.assert_array_equal(np.array(points, np.float32), cloud.points)
    assert logged["/cloud"]["Points3D:class_ids"][1] == cloud.semantic.tolist()
    times = prediction.latency
    assert logged["/latency/total"]["Scalars:scalars"] == [[times.total_ms]] * 3
    assert logged["/latency/inference"]["Scalars:scalars"] == [[times.inference_ms]] * 3
    assert logged["/latency/total"]["frame"] == [0, 1, 2]
    sensor = [each for each in logged["/latency/total"]["sensor"] if each is not None]
    assert sensor == [timedelta(seconds=1), timedelta(seconds=2)]


def test_without_a_camera_there_is_no_cloud(tmp_path, calm, open_run):
    with open_rerun(open_run(rerun=str(tmp_path / "a.rrd"))) as log:
        log.write(*calm)
    logged = read_log(tmp_path / "a.rrd")
    assert "/camera/depth" in logged
    assert "/cloud" not in logged


def test_an_error_leaves_no_file(tmp_path, calm, open_run):
    def fail():
        with open_rerun(open_run(rerun=str(tmp_path / "a.rrd"))) as log:
            log.write(*calm)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]


def test_a_full_disk_is_an_output_error(mount_disk, tmp_path, answered):
    """The SDK would wait for ever, also when the interpreter ends: in a process of its own."""
    folder = mount_disk(64)
    program = (
        "import sys; from pathlib import Path; import numpy as np\n"
        "from runtime import Predictor, OutputError\n"
        "from runtime.sources.frames import Frame\n"
        "from runtime.run.options import RunOptions\n"
        "from runtime.run.outputs import rerun_log\n"
        "from runtime.run.outputs.output import OpenRun\n"
        "rerun_log._PATIENCE_S = 1.0\n"
        "predictor = Predictor(sys.argv[1], threads=1)\n"
        "rgb = np.random.default_rng(0).integers(1, 255, (200, 300, 3), dtype=np.uint8)\n"
        "rgb[..., 1] = rgb[..., 2] // 2\n"
        "frame = Frame(rgb, np.ones((200, 300), np.float32))\n"
        "answer = predictor.predict(frame.rgb, frame.sparse_depth)\n"
        "try:\n"
        "    options = RunOptions(demo=True, rerun=sys.argv[2])\n"
        "    with rerun_log.open_rerun(OpenRun(options, predictor, None)) as log:\n"
        "        for _ in range(20): log.write(frame, answer)\n"
        "except OutputError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "model.onnx", folder / "a.rrd"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "free some space" in done.stdout, done.stderr
    assert not list(folder.iterdir())


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_a_viewer_that_is_not_there_is_an_output_error(calm, monkeypatch, open_run):
    monkeypatch.setattr(rerun_log, "_PATIENCE_S", 1.0)

    def log_to_nobody():
        target = f"rerun+http://127.0.0.1:{free_port()}/proxy"
        with open_rerun(open_run(rerun=target)) as log:
            log.write(*calm)

    with pytest.raises(OutputError, match=r"cannot log x .*check that the viewer is running"):
        log_to_nobody()


def test_the_viewer_of_an_environment_that_is_not_active_is_found(calm, monkeypatch, open_run):
    found = []
    monkeypatch.setattr(
        rerun.RecordingStream,
        "spawn",
        lambda self, **options: found.append(shutil.which("rerun")),
    )
    monkeypatch.setenv("PATH", "/nowhere")
    with open_rerun(open_run(rerun="live")) as log:
        log.write(*calm)
    assert found == [str(Path(sys.executable).with_name("rerun"))]
    assert os.environ["PATH"] == "/nowhere"


def test_a_viewer_gets_every_frame(tmp_path, run):
    """A viewer without a window: it keeps what comes."""
    command = Path(importlib.util.find_spec("rerun_cli").origin).with_name("rerun")
    port, kept = free_port(), tmp_path / "kept.rrd"
    viewer = subprocess.Popen(
        [command, "--port", str(port), "--save", kept],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + 30
        while time.monotonic() < until:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        result = run("--save", "none", "--rerun", f"rerun+http://127.0.0.1:{port}/proxy")
        assert result.exit_code == 0, result.output
        size = -1
        while time.monotonic() < until and size != (size := os.path.getsize(kept)):
            time.sleep(0.5)
    finally:
        viewer.terminate()
        viewer.wait(20)
    assert read_log(kept)["/latency/total"]["frame"] == list(range(12))


def test_after_a_signal_its_frames_are_those_of_the_table(tmp_path, run, signal_in_frame_6):
    path = tmp_path / "out" / "run.rrd"
    result = run("--warmup", 0, "--rerun", path, "--focal-length", 60)
    assert result.exit_code == 3, result.output
    assert f"rerun: {path}" in result.stdout
    logged = read_log(path)
    for entity in ("/camera/image", "/cloud", "/latency/total"):
        assert logged[entity]["frame"] == list(range(7))
    assert len(list((tmp_path / "out/depth").iterdir())) == 7
