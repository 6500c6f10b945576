"""ssdnet-run --record, then ssdnet-verify: the same answers pass, others are reported by frame."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from typer.testing import CliRunner

import runtime
from runtime import Predictor
from runtime.app.run.cli import app as run_app
from runtime.app.tools.verify import app
from runtime.engine.bundled_models import find_model
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.verification.reference import (
    PredictorSettings,
    ReferenceFrame,
    read_reference,
    write_reference,
)

HEADS = ("semantic", "depth", "boundary", "depth_uncertainty", "semantic_logits")
NAMES = ["f0", "f1", "f2"]


def run(*arguments):
    return CliRunner().invoke(run_app, [str(argument) for argument in arguments])


def verify(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def stream(make_stream) -> list[object]:
    """The options that name three frames of 48 x 64."""
    rgb, depth = make_stream(len(NAMES))
    return ["--rgb", rgb, "--depth", depth, "--save", "none"]


@pytest.fixture
def recording(tmp_path, stream, model_file) -> Path:
    """The stream and the answers of a model made by hand."""
    folder, model = tmp_path / "recording", model_file(heads=HEADS)
    options = ["--model", model, "--out", tmp_path / "out", "--record", folder, "--size", "40x56"]
    result = run(*stream, *options)
    assert result.exit_code == 0, result.output
    assert f"reference: {folder}" in result.output.splitlines()
    model.unlink()  # the recording holds its own
    return folder


def spoil(recording, index, head, change):
    """Change an answer as if it had been recorded so."""
    path = recording / "frames" / f"{index:06}.npz"
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays[head] = change(arrays[head])
    np.savez(path, **arrays)


def test_the_same_answers_pass(recording):
    result = verify(recording)
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert (lines[1][-18:], lines[-1]) == (", the recorded one", "the same answers")
    assert f"by ssdnet-run {runtime.__version__} on cpu, ONNX Runtime" in lines[0]
    assert any(line.split()[:3] == ["depth", "max_abs_m", "0"] for line in lines)


@pytest.mark.parametrize(("head", "change", "reported"), [
    ("depth", lambda values: values + np.float32(0.25), ["max_abs_m", "0.25"]),
    ("depth_uncertainty", lambda values: values + np.float32(0.25), ["max_abs_m", "0.25"]),
    ("boundary", lambda values: np.maximum(values - 0.5, 0), ["mean_abs"]),
    ("semantic", lambda values: 1 - values, ["agreement", "0"]),
    ("semantic_logits", lambda values: values * np.float32(0.5), ["max_relative", "1"]),
    ("depth", lambda values: values * np.nan, ["max_abs_m", "nan"]),
])  # fmt: skip
def test_what_differs_is_one_line_with_its_worst_frame(recording, head, change, reported):
    spoil(recording, 1, head, change)
    result = verify(recording)
    assert result.exit_code == 4
    lines = result.output.splitlines()
    assert lines[-1] == "1 of 3 frames differ from the reference"
    assert "\n  " not in result.output, "no line a frame"
    words = [line.split() for line in lines]
    (line,) = [each for each in words if each[-2:] == ["1", "f1"]]
    assert line[: 1 + len(reported)] == [head, *reported]
    rows = json.loads(verify(recording, "--json", "-").output)["figures"]
    beyond = [row for row in rows if row["frames_beyond"]]
    (row,) = beyond
    assert (row["head"], row["figure"], row["frame"]) == (head, reported[0], "f1")
    assert row["worst"] is None or row["worst"] != row["limit"]


def test_answers_of_another_shape_are_reported_once(recording):
    for index in (1, 2):
        spoil(recording, index, "depth", lambda values: values[:-1])
    result = verify(recording)
    assert result.exit_code == 4
    expected = "  depth: shape (48, 64), expected (47, 64) (2 frames, the first is f1)"
    assert expected in result.output.splitlines()


@pytest.mark.parametrize(("limits", "code"), [
    (["depth.mean=0.03"], 0), (["depth.mean=0.02"], 4), (["depth.p99=0.001"], 0),
    (["depth.p99=0.001", "depth.max=1"], 4), (["depth.p99.9=9", "depth.max=9"], 0),
    (["semantic.equal=1", "depth=9"], 0), (["depth.equal=1"], 2), (["semantic.mean=1"], 2),
    (["depth.p101=1"], 2), (["depth.median=1"], 2), (["boundary=1"], 4), (["speed=1"], 1),
    (["depth"], 2), (["depth=-1"], 2), (["depth=inf"], 2),
])  # fmt: skip
def test_a_tolerance_limits_a_head_or_one_of_its_figures(recording, limits, code):
    def change(values):
        values[:1, :10] += np.float32(8)  # of 3072 pixels: 0.026 m in the mean
        return values

    spoil(recording, 0, "depth", change)
    options = [word for limit in limits for word in ("--tolerance", limit)]
    result = verify(recording, *options)
    assert result.exit_code == code, result.output


def test_classes_are_compared_by_name(tmp_path, model_file, make_frame, contract):
    """A recorded file with the same classes in another order gives the same names."""
    rgb, depth = make_frame()
    model, folder = model_file("a.onnx", heads=HEADS), tmp_path / "recording"
    turned = replace(contract, classes=contract.classes[::-1])
    with (
        Predictor(model, threads=1) as predictor,
        write_reference(folder, PredictorSettings("test")) as recorder,
    ):
        heads = dict(predictor.predict(rgb, depth).heads)
        heads["semantic"] = len(contract.classes) - 1 - heads["semantic"]
        heads["semantic_logits"] = heads["semantic_logits"][::-1]
        recorder.add(ReferenceFrame("0"), rgb, depth, heads)
        recorder.finish(model_file("b.onnx", heads=HEADS, contract=turned))
    result = verify(folder, "--model", model)
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[-1] == "the recorded answers, within the limits"
    classes = (replace(contract.classes[0], name="moose"), *contract.classes[1:])
    other = model_file("c.onnx", heads=HEADS, contract=replace(contract, classes=classes))
    result = verify(folder, "--model", other)
    assert result.exit_code == 1
    assert f"it adds moose; it lacks {contract.classes[0].name}" in result.output


def test_a_file_of_the_same_checkpoint_has_the_limits_of_the_less_exact_one(int8_recording):
    """The bundled 8-bit file against the one in single precision; another model fails."""
    result = verify(int8_recording, "--model", "ssdnet-nano", "--threads", 1)
    assert result.exit_code == 0, result.output
    assert any(line.split()[:2] == ["depth", "mean_relative"] for line in lines_of(result))


def lines_of(result):
    return result.output.splitlines()


def test_a_recording_is_unpacked_into_plain_files(recording, tmp_path):
    plain = tmp_path / "plain"
    edit_frames(recording, focal_length_px=None)
    result = verify(recording, "--unpack", plain)
    assert (result.exit_code, result.output) == (0, f"3 frames: {plain / 'manifest.json'}\n")
    manifest, read = json.loads((plain / "manifest.json").read_text()), read_reference(recording)
    assert (plain / "model.onnx").read_bytes() == read.model.read_bytes()
    assert manifest["model"]["sha256"] == read.model_sha256
    assert manifest["limits"] == read.limits
    frame = manifest["frames"][1]
    assert frame["name"] == "f1"
    assert frame["network_size"] == [40, 56]
    assert sorted(frame["arrays"]) == sorted(["rgb", "sparse_depth", *HEADS])
    for name, expected in read.arrays(1).items():
        path = plain / frame["folder"] / f"{name}.npy"
        assert path.read_bytes()[:8] == b"\x93NUMPY\x01\x00"
        np.testing.assert_array_equal(np.load(path), expected)
    assert verify(recording, "--unpack", plain).exit_code == 1, "it is not replaced"
    assert verify(recording, "--unpack", plain, "--overwrite").exit_code == 0
    assert verify(recording, "--unpack", plain, "--model", "ssdnet-nano").exit_code == 2


def edit_frames(recording, **changes):
    path = recording / "reference.json"
    document = json.loads(path.read_text())
    for frame in document["frames"]:
        frame.update(changes)
    path.write_text(json.dumps(document))


def test_times_are_compared_only_when_asked(recording):
    edit_frames(recording, predict_ms=1e-6)
    assert verify(recording).exit_code == 0
    result = verify(recording, "--max-slowdown", 2)
    assert result.exit_code == 4
    assert result.output.splitlines()[-1].endswith("at most 2")
    edit_frames(recording, predict_ms=1e6)
    assert verify(recording, "--max-slowdown", 1).exit_code == 0
    assert verify(recording, "--max-slowdown", 0).exit_code == 2
    edit_frames(recording, predict_ms=None)
    result = verify(recording, "--max-slowdown", 1)
    assert (result.exit_code, "has none" in result.output) == (1, True)


def test_the_time_may_have_a_limit_in_milliseconds(recording):
    assert verify(recording, "--max-latency-ms", 1e6).exit_code == 0
    result = verify(recording, "--max-latency-ms", 1e-6)
    assert result.exit_code == 4
    assert re.search(r"take [0-9.]+ ms at the median, expected at most 1e-06 ms$", result.output)
    report = json.loads(verify(recording, "--max-latency-ms", 1e-6, "--json", "-").output)
    assert not report["passed"]
    assert report["median_ms"] > report["max_latency_ms"] == 1e-6


def test_other_flags_than_recorded_are_reported(recording):
    edit_frames(recording, degraded=["no_depth"])
    result = verify(recording)
    assert result.exit_code == 4
    expected = "  degraded: none, expected no_depth (3 frames, the first is f0)"
    assert expected in result.output.splitlines()
    edit_frames(recording, degraded=None)  # not known
    assert verify(recording).exit_code == 0
    edit_frames(recording, name="\x1b[2J", degraded=["no_depth"])
    assert r"the first is \x1b[2J)" in verify(recording).output, "no terminal escapes"


def test_another_model_is_held_against_the_recorded_answers(recording, model_file, change_run):
    def farther(graph):
        (offset,) = [weight for weight in graph.initializer if weight.name == "offset"]
        offset.raw_data = np.float32(2.0).tobytes()

    other = model_file("other.onnx", heads=HEADS, edit=farther)
    result = verify(recording, "--model", other)
    assert result.exit_code == 4
    assert "NOT the recorded one" in result.output
    found = [line.split() for line in lines_of(result)]
    (worst,) = [float(words[2]) for words in found if words[:2] == ["depth", "max_abs_m"]]
    assert 0.5 <= worst < 0.6
    fewer = model_file("fewer.onnx", heads=("depth",))
    assert "heads: depth, expected boundary" in verify(recording, "--model", fewer).output

    def fail(run, feed):
        if np.ptp(feed["rgb"]):  # not the gray frame of the start
            raise RuntimeError("broken")
        return run()

    change_run(fail)
    failed = verify(recording)
    assert failed.exit_code == 4
    assert "  the session failed on a frame of 40 x 56" in failed.output
    assert "(3 frames, the first is f0)" in failed.output


def test_a_changed_or_damaged_recording_is_an_error(recording, model_file):
    (recording / "frames" / "000001.npz").write_bytes(b"")
    result = verify(recording)
    assert (result.exit_code, "damaged" in result.output) == (1, True)
    shutil.copy(model_file("other.onnx"), recording / "model.onnx")
    result = verify(recording)
    assert (result.exit_code, "expected" in result.output) == (1, True)


def test_only_frames_with_an_answer_are_recorded_and_none_do_not_pass(tmp_path, stream, model_file):
    options = [*stream, "--model", model_file(), "--out", tmp_path / "out", "--overwrite"]
    options += ["--record", tmp_path / "recording"]
    (tmp_path / "cam" / "f0.png").write_bytes(b"no picture")
    assert run(*options).exit_code == 3
    assert [frame.name for frame in read_reference(tmp_path / "recording").frames] == NAMES[1:]
    for path in (tmp_path / "cam").iterdir():
        path.write_bytes(b"no picture")
    assert run(*options).exit_code == 3
    result = verify(tmp_path / "recording")
    assert result.exit_code == 4
    assert "holds no frames" in result.output.splitlines()[-1]


@pytest.fixture(scope="module")
def int8_recording(tmp_path_factory) -> Path:
    """Two frames of the bundled stream and the answers of a bundled 8-bit model."""
    folder = tmp_path_factory.mktemp("int8") / "recording"
    focal_px = BUNDLED_FOCAL_LENGTH_PX
    settings = PredictorSettings("the-test", focal_length_px=focal_px)
    with (
        Predictor("ssdnet-nano-int8", focal_length_px=focal_px, threads=1) as predictor,
        write_reference(folder, settings) as recorder,
    ):
        for frame in bundled_frames()[::10][:2]:
            rgb, depth = frame.rgb[-128:, :416], frame.sparse_depth[-128:, :416]
            heads = predictor.predict(rgb, depth).heads
            recorder.add(ReferenceFrame(frame.name), rgb, depth, heads)
        recorder.finish(find_model("ssdnet-nano-int8"))
    return folder


@pytest.mark.parametrize("level", ["ORT_DISABLE_ALL", "ORT_ENABLE_ALL"])
def test_an_8_bit_file_verifies_where_it_rounds_elsewhere(int8_recording, monkeypatch, level):
    class Session(onnxruntime.InferenceSession):
        def __init__(self, model, sess_options, **options):
            optimization = getattr(onnxruntime.GraphOptimizationLevel, level)
            sess_options.graph_optimization_level = optimization
            super().__init__(model, sess_options, **options)

    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)
    result = verify(int8_recording, "--threads", 1)
    assert result.exit_code == 0, result.output
    (line,) = [line for line in result.output.splitlines() if line.startswith("semantic ")]
    agreement = float(line.split()[2])
    assert agreement == 1 if level == "ORT_ENABLE_ALL" else agreement < 0.9999


def test_an_8_bit_file_does_not_verify_other_returns_or_models(int8_recording, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(int8_recording, copy)
    spoil(copy, 1, "sparse_depth", lambda depth: depth * np.float32(0.7))
    result = verify(copy)
    assert result.exit_code == 4
    assert "1 of 2 frames differ" in result.output
    assert ["depth", "mean_relative"] in [line.split()[:2] for line in lines_of(result)]
    other = verify(int8_recording, "--model", "ssdnet-lite-int8", "--threads", 1)
    assert "2 of 2 frames differ" in other.output


def test_the_document_is_written_beside_the_table(recording, tmp_path):
    path = tmp_path / "a.json"
    printed = verify(recording, "--json", path)
    assert printed.exit_code == 0
    assert printed.output.rstrip().endswith("the same answers")
    written, printed = json.loads(path.read_text()), verify(recording, "--json", "-").output
    assert written["figures"] == json.loads(printed)["figures"]
    assert verify(recording, "--json", path).exit_code == 1
    assert verify(recording, "--json", path, "--overwrite").exit_code == 0
