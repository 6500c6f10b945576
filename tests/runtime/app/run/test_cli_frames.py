"""Which frames ssdnet-run reads, and what it does with those that are bad."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import runtime.recordings.bundled_stream
from cli_runs import N, arguments, files_in, rows_of
from runtime.app.run.cli import app
from runtime.app.run.options import KINDS
from runtime.verification.reference import read_reference


@pytest.fixture
def red_metres(tmp_path, make_stream, model_file, contract):
    """Write two frames whose depth is red / 16 metres: their folders, a model that answers this."""

    def see_red(graph):
        (node,) = (each for each in graph.node if each.output[0] == "depth")
        graph.node.remove(node)
        node.op_type, node.input[:] = "Mul", ["red", "sixteenth"]
        graph.node.insert(3, node)

    folders = make_stream(2)
    red = (4000 / (20 + np.arange(48)[:, None]) - np.arange(64) / 2).astype(np.uint8)
    for name in ("f0.png", "f1.png"):
        cv2.imwrite(str(folders[0] / name), np.stack([red, red // 2, red], axis=-1))
        cv2.imwrite(str(folders[1] / name), np.rint(red / 16 * 1000).astype(np.uint16))
    contract = replace(contract, canonical_focal_px=100.0)
    return folders, model_file(edit=see_red, contract=contract, heads=("semantic", "depth"))


@pytest.mark.parametrize(
    ("scale", "warning"),
    [
        (256, "the returns are 3.9 times as far as the depth predicted from the image: try "
         "depth_scale=1000 in --source"),
        (1000, None),
    ],
)  # fmt: skip
def test_depth_that_contradicts_the_image_is_reported(tmp_path, red_metres, scale, warning):
    ((rgb, depth), model), recording = red_metres, tmp_path / "recording"
    source = ["--source", f"folders:{rgb},depth_scale={scale}", "--depth", depth]
    given = [*source, "--model", model, "--out", tmp_path / "out", "--record", recording]
    result = CliRunner().invoke(app, [str(word) for word in given])
    warned = re.findall(r"^warning: (.*) \(fit as given.*$", result.stderr, re.MULTILINE)
    assert warned == ([warning] if warning else [])
    assert result.exit_code == (3 if warning else 0), result.output
    frames = json.loads((tmp_path / "out/report.json").read_text())["frames"]
    assert [each["says"] for each in frames["findings"]] == warned
    assert (frames["implausible_depth"] is None) == (warning is None)
    assert frames["degraded"] == ({"implausible_depth": 2} if warning else {})
    rows = rows_of(tmp_path / "out")
    assert {row["degraded"] for row in rows} == {"implausible_depth" if warning else ""}
    recorded = read_reference(recording).frames
    assert [frame.degraded for frame in recorded] == [(), ()], "what ssdnet-verify predicts again"


def test_shards_are_disjoint_and_together_the_whole(tmp_path, run):
    """Four frames are compared byte for byte; a part without a frame is a run of no frames."""
    parts = 5
    assert run("--out", tmp_path / "whole", "--limit", 4).exit_code == 0
    union = {}
    for part in range(1, parts + 1):
        folder = tmp_path / str(part)
        result = run("--out", folder, "--limit", 4, "--shard", f"{part}/{parts}")
        assert result.exit_code == 0, result.output
        files = {file for file in files_in(folder) if Path(file).parent.name in KINDS}
        assert len(rows_of(folder)) == len(range(part - 1, 4, parts))
        assert not files & union.keys()
        union |= {file: (folder / file).read_bytes() for file in files}
        report = json.loads((folder / "report.json").read_text())
        assert report["inputs"]["shard"] == f"{part}/{parts}"
    whole = tmp_path / "whole"
    answers = {file for file in files_in(whole) if Path(file).parent.name in KINDS}
    assert len(answers) == 4 * len(KINDS)
    assert union == {file: (whole / file).read_bytes() for file in answers}
    assert run("--limit", 5, "--shard", "2/2").exit_code == 0
    assert [row["name"] for row in rows_of(tmp_path / "out")] == ["f1", "f3"], "of the first five"


def test_the_demo_runs_the_bundled_stream(tmp_path, stream, model_file, monkeypatch):
    bundled = tmp_path / "assets" / "stream"
    bundled.mkdir(parents=True)
    arguments = ["--demo", "--model", str(model_file()), "--out", str(tmp_path / "out")]
    resources = runtime.recordings.bundled_stream.resources
    monkeypatch.setattr(resources, "files", lambda package: tmp_path)
    empty = CliRunner().invoke(app, arguments)
    assert empty.exit_code == 1
    stream[0].rename(bundled / "rgb")
    stream[1].rename(bundled / "depth")
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert len(rows_of(tmp_path / "out")) == N
    inputs = json.loads((tmp_path / "out/report.json").read_text())["inputs"]
    assert inputs["focal_length_px"] == pytest.approx(483.35, abs=0.01)  # of the rendered camera


# --- bad input ---------------------------------------------------------------------------------


def test_skipped_frames_are_counted_named_and_exit_code_3(tmp_path, run, stream):
    rgb, depth = stream
    (rgb / "f0.png").write_bytes(b"")
    for name in ("f1", "f3"):
        (depth / f"{name}.png").unlink()
    (rgb / "f2.png").unlink()
    picture = rgb / "f4.png"
    picture.write_bytes(picture.read_bytes()[:700])
    cv2.imwrite(str(depth / "f5.png"), np.zeros((48, 64), np.uint16))
    cv2.imwrite(str(depth / "f6.png"), np.zeros((48, 64), np.uint8))
    cv2.imwrite(str(depth / "f8.png"), np.zeros((40, 64), np.uint16))
    result = run()
    assert result.exit_code == 3
    assert "frames: 12 (7 skipped, 5 ok)" in result.stdout
    assert "degraded: no_depth: 1" in result.stdout
    rows = {row["name"]: row for row in rows_of(tmp_path / "out")}
    reasons = {
        "f0": "is empty", "f1": "no depth map", "f2": "no image", "f3": "no depth map",
        "f4": "truncated", "f6": "got uint8", "f8": "(40, 64)",
    }  # fmt: skip
    assert {name for name, row in rows.items() if row["status"] == "skipped"} == set(reasons)
    for name, reason in reasons.items():
        assert reason in rows[name]["reason"]
        assert rows[name]["predict_ms"] == ""
        if name in ("f2", "f6", "f8"):
            assert re.search(rf"  {name}: skipped: .*{re.escape(reason)}", result.stdout)
    assert f"\n  2 frames, first f0: skipped: {rgb / 'f0.png'} is empty, trunc" in result.stdout
    assert "\n  2 frames, first f1: skipped: f1 has an image, but no depth map\n" in result.stdout
    assert rows["f5"]["degraded"] == "no_depth"
    written = {p.stem for p in (tmp_path / "out/overlay").iterdir()}
    assert written == rows.keys() - reasons.keys()


@pytest.mark.parametrize("last", [False, True])
def test_a_lidar_that_starts_after_the_checked_frames_is_no_fault(tmp_path, run, stream, last):
    """All that a run looks at before it starts is empty; without any return it is reported."""
    for path in sorted(stream[1].iterdir()):
        if path.stem != "f11" or not last:
            cv2.imwrite(str(path), np.zeros((48, 64), np.uint16))
    result = run("--save", "none")
    assert "warning: no scan or depth map of the first frames has a return" in result.stderr
    fault = json.loads((tmp_path / "out/report.json").read_text())["frames"]["implausible_depth"]
    assert (fault is None, result.exit_code) == ((True, 0) if last else (False, 3))


def test_a_picture_of_another_size_than_the_calibrations_is_skipped(tmp_path, run, stream):
    size = "size = [48, 64]"
    matrices = f"intrinsics = {[[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]}\nextrinsics = "
    calibration = tmp_path / "camera.toml"
    calibration.write_text(f"{size}\n{matrices}{np.eye(4).tolist()}\n")
    cv2.imwrite(str(stream[0] / "f3.png"), np.full((50, 64, 3), 90, np.uint8))
    cv2.imwrite(str(stream[1] / "f3.png"), np.full((50, 64), 2560, np.uint16))
    result = run("--calibration", calibration, "--save", "depth,cloud")
    assert result.exit_code == 3, result.output
    skipped = [row for row in rows_of(tmp_path / "out") if row["status"] == "skipped"]
    assert [row["name"] for row in skipped] == ["f3"]
    assert "for images of (48, 64)" in skipped[0]["reason"]
    assert len(list((tmp_path / "out/cloud").iterdir())) == N - 1


@pytest.mark.parametrize("n", [19, 21])
def test_a_stream_that_is_refused_from_the_start_is_an_error(tmp_path, make_stream, all_heads, n):
    folders = make_stream(n)
    for path in folders[1].iterdir():
        assert cv2.imwrite(str(path), np.zeros((40, 64), np.uint16))
    result = CliRunner().invoke(app, arguments(folders, all_heads, tmp_path))
    if n < 20:
        assert result.exit_code == 3
        assert f"{n} frames, first f0: skipped: sparse_depth must have the shape" in result.stdout
    else:
        assert result.exit_code == 1
        assert "error: none of the first 20 frames can be predicted" in result.stderr
        assert "20 frames, first f0: sparse_depth must have the shape" in result.stderr
        assert not (tmp_path / "out").exists()
