"""ssdnet-run from the outside: files, tables, exit codes."""

import csv
import dataclasses
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import runtime.run.pipeline
import runtime.run.report_files
import runtime.run.run
import runtime.sources.bundled_stream
import runtime.sources.folders
from runtime import list_bundled_models
from runtime.bundled_models import find_model
from runtime.io.recording import read_recording
from runtime.model_file import load_model_file
from runtime.run.cli import app
from runtime.run.run_folder import KINDS

N = 12


def arguments(stream: tuple[Path, Path], model: Path, folder: Path) -> list[str]:
    rgb, depth = stream
    given = ["--rgb", rgb, "--depth", depth, "--model", model, "--out", folder / "out"]
    return [str(a) for a in [*given, "--threads", 1]]


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "frames.csv").open() as file:
        return list(csv.DictReader(file))


def files_in(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_a_run_from_end_to_end(tmp_path, run):
    result = run("--deadline-ms", 60_000)
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    names = [f"f{index}" for index in range(N)]
    for kind in ("semantic", "depth", "uncertainty", "boundary"):
        assert {p.name for p in (out / kind).iterdir()} == {f"{n}.png" for n in names}
    assert len(list((out / "overlay").glob("*.jpg"))) == N

    first_line, *_, last_line = result.stdout.strip().splitlines()
    assert re.match(
        r"by-hand sha256:[0-9a-f]{12} \| CPUExecutionProvider [1-9]\d* nodes \| threads 1 \| "
        r"frames 48 x 64, network at 48 x 64$",
        first_line,
    )
    assert last_line == f"pictures: {out / 'overlay'}"
    for stage in ("read", "preprocess", "inference", "postprocess", "predict", "write"):
        (line,) = re.findall(rf"^{stage} .*$", result.stdout, re.MULTILINE)
        assert line.split()[1] == str(N)
        assert line.split()[5:7] == ["n/a", "n/a"], "12 frames support no p99"
    assert re.search(r"frames a second, end to end: \d", result.stdout)
    assert re.search(r"load \d+ ms, first inference [\d.]+ ms", result.stdout)
    assert "missed deadlines of 60000 ms: 0, longest run 0" in result.stdout
    assert cv2.imread(str(out / "latency.png")) is not None


@pytest.mark.parametrize(
    ("size", "runs_at"),
    [("auto", (40, 53)), ("frame", (52, 69)), ("64", (64, 85)), ("33x70", (33, 70))],
)
def test_the_size_at_which_the_network_ran_is_reported(
    tmp_path, make_frame, model_file, contract, size, runs_at
):
    for folder in ("cam", "lidar"):
        (tmp_path / folder).mkdir()
    rgb, depth = make_frame(52, 69)
    cv2.imwrite(str(tmp_path / "cam/f.png"), rgb[..., ::-1])
    cv2.imwrite(str(tmp_path / "lidar/f.png"), np.rint(depth * 256).astype(np.uint16))
    model = model_file(contract=dataclasses.replace(contract, trained_height=40))
    given = arguments((tmp_path / "cam", tmp_path / "lidar"), model, tmp_path)
    result = CliRunner().invoke(app, [*given, "--size", size])
    assert result.exit_code == 0, result.output
    height, width = runs_at
    assert f"frames 52 x 69, network at {height} x {width}\n" in result.stdout
    (row,) = rows_of(tmp_path / "out")
    assert (row["height"], row["width"]) == ("52", "69")
    assert (row["network_height"], row["network_width"]) == (str(height), str(width))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["frames"]["by_network_size"] == {f"{height} x {width}": 1}
    assert report["model"]["trained_height"] == 40
    assert cv2.imread(str(tmp_path / "out/semantic/f.png"), -1).shape == (52, 69)


def test_a_size_that_the_command_does_not_know_is_a_usage_error(run):
    result = run("--size", "large")
    assert result.exit_code == 2
    assert "--size 'large'" in result.output


def test_the_rows_and_the_report_agree(tmp_path, run):
    run("--deadline-ms", 60_000, "--warmup", 2)
    rows = rows_of(tmp_path / "out")
    assert [row["name"] for row in rows] == [f"f{index}" for index in range(N)], "natural order"
    assert {row["status"] for row in rows} == {"ok"}
    assert {(row["height"], row["width"]) for row in rows} == {("48", "64")}
    assert {row["missed_deadline"] for row in rows} == {"0"}
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["format"], report["version"]) == ("ssdnet-run", "1.8")
    assert report["frames"]["by_status"] == {"ok": N}
    assert report["provider"]["threads"] == 1
    assert report["provider"]["nodes"]["CPUExecutionProvider"] > 5
    assert len(report["model"]["sha256"]) == 64
    assert report["machine"]["cpu"]
    assert report["deadline"] == {"deadline_ms": 60_000, "count": 0, "longest_run": 0}
    assert report["load_ms"] > 0
    assert report["first_inference_ms"] > 0
    assert report["frames_per_second"] == pytest.approx(N / report["wall_s"])
    for stage, statistics in report["stages"].items():
        times = [float(row[f"{stage}_ms"]) for row in rows]
        assert statistics["n"] == N
        assert statistics["mean_ms"] == pytest.approx(np.mean(times), abs=1e-3)
        assert statistics["max_ms"] == pytest.approx(max(times), abs=1e-3)
        assert statistics["median_ms"] == pytest.approx(sorted(times)[N // 2 - 1], abs=1e-3)
        assert statistics["p99_9_ms"] is None
    predict = [float(row["predict_ms"]) for row in rows]
    parts = [
        sum(float(row[f"{stage}_ms"]) for stage in ("preprocess", "inference", "postprocess"))
        for row in rows
    ]
    assert predict == pytest.approx(parts, abs=0.1)


def test_a_constant_stream_reports_age_and_jitter(tmp_path, run):
    result = run("--rate", 10_000, "--deadline-ms", 1e-3)  # due long before they can be done
    assert result.exit_code == 4
    assert "constant stream of 10000 Hz" in result.stdout
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["scenario"] == {"name": "constant-stream", "rate_hz": 10_000}
    rows = rows_of(tmp_path / "out")
    ages = [float(row["age_ms"]) for row in rows]
    assert report["stages"]["age"]["n"] == N
    assert report["stages"]["age"]["max_ms"] == pytest.approx(max(ages), abs=1e-3)
    assert [row["jitter_ms"] == "" for row in rows] == [True] + [False] * (N - 1)
    assert float(rows[1]["jitter_ms"]) == pytest.approx(abs(ages[1] - ages[0]), abs=2e-3)
    assert report["deadline"]["count"] == N
    assert all(age > float(row["predict_ms"]) for age, row in zip(ages, rows, strict=True))
    for stage in ("age", "jitter"):
        assert re.search(rf"^{stage} +\d", result.stdout, re.MULTILINE)


def test_a_single_stream_reports_no_age_and_leaves_the_cells_empty(tmp_path, run):
    result = run()
    assert "constant stream" not in result.stdout
    assert not re.search(r"^(age|jitter) ", result.stdout, re.MULTILINE)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["scenario"] == {"name": "single-stream", "rate_hz": None}
    assert {row["age_ms"] + row["jitter_ms"] for row in rows_of(tmp_path / "out")} == {""}


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_a_rate_out_of_range_is_a_usage_error(run, rate):
    result = run("--rate", rate)
    assert result.exit_code == 2
    assert "--rate" in result.output


def test_json_is_the_report_and_nothing_else(tmp_path, run):
    result = run("--json")
    assert json.loads(result.stdout) == json.loads((tmp_path / "out/report.json").read_text())


def test_the_depth_scale(tmp_path, run, stream):
    run("--depth-scale", 512, "--save", "depth")
    units = cv2.imread(str(stream[1] / "f0.png"), cv2.IMREAD_UNCHANGED) / 512
    depth = cv2.imread(str(tmp_path / "out/depth/f0.png"), cv2.IMREAD_UNCHANGED) / 256
    np.testing.assert_allclose(depth, units + 1.5, atol=0.51 / 256)


@pytest.fixture
def run_metres(tmp_path, model_file):
    """Run a model that sees red / 16 metres on two frames, whose depth PNGs are made of them."""

    def see_red(graph):
        (node,) = (each for each in graph.node if each.output[0] == "depth")
        graph.node.remove(node)
        node.op_type, node.input[:] = "Mul", ["red", "sixteenth"]
        graph.node.insert(3, node)

    def invoke(to_units, *given):
        folders = tmp_path / "cam", tmp_path / "lidar"
        red = (4000 / (20 + np.arange(48)[:, None]) - np.arange(64) / 2).astype(np.uint8)
        bgr, depth = np.stack([red, red // 2, red], axis=-1), np.rint(to_units(red / 16))
        for folder, picture in zip(folders, (bgr, depth.astype(np.uint16)), strict=True):
            folder.mkdir()
            for name in ("0.png", "1.png"):
                assert cv2.imwrite(str(folder / name), picture)
        model = model_file(edit=see_red)
        result = CliRunner().invoke(app, [*arguments(folders, model, tmp_path), *map(str, given)])
        assert result.exit_code == 0, result.output
        return result

    return invoke


@pytest.mark.parametrize(
    ("to_units", "scale", "warning"),
    [
        (lambda m: m * 1000, 256, "the returns are 3.9 times as far as the camera alone sees: "
         "try --depth-scale 1000"),
        (lambda m: m * 256, 2560, "the returns are 0.1 times as far as the camera alone sees: "
         "try --depth-scale 256"),
        (lambda m: m * 25.6, 256, "the returns are 0.1 times as far as the camera alone sees: "
         "try --depth-scale of about 26"),
        (lambda m: m[:, ::-1] * 256, 256, "the returns fit the mirrored image: left and right are "
         "swapped in one of them"),
        (lambda m: 65535 / m, 256, "the returns are far where the camera alone sees near: they may "
         "be inverse depth or disparity"),
        (lambda m: m * 1000, 1000, None),
    ],
)  # fmt: skip
def test_depth_that_contradicts_the_image_is_reported(
    tmp_path, run_metres, to_units, scale, warning
):
    recording = tmp_path / "recording"
    result = run_metres(to_units, "--depth-scale", scale, "--record", recording)
    warned = re.findall(r"^warning: (.*)$", result.stdout, re.MULTILINE)
    assert warned == ([warning] if warning else [])
    frames = json.loads((tmp_path / "out/report.json").read_text())["frames"]
    assert frames["implausible_depth"] == warning
    assert frames["degraded"] == ({"implausible_depth": 2} if warning else {})
    rows = rows_of(tmp_path / "out")
    assert {row["degraded"] for row in rows} == {"implausible_depth" if warning else ""}
    recorded = read_recording(recording).frames
    assert [frame.degraded for frame in recorded] == [(), ()], "what ssdnet-verify predicts again"


@pytest.mark.parametrize("parts", [1, 3, N, N + 2])
def test_shards_are_disjoint_and_together_the_whole(tmp_path, run, parts):
    """Byte for byte; a part without a frame is a run of none."""
    assert run("--out", tmp_path / "whole").exit_code == 0
    union = {}
    for part in range(1, parts + 1):
        folder = tmp_path / str(part)
        result = run("--out", folder, "--shard", f"{part}/{parts}")
        assert result.exit_code == 0, result.output
        files = {file for file in files_in(folder) if Path(file).parent.name in KINDS}
        assert len(rows_of(folder)) == len(range(part - 1, N, parts))
        assert not files & union.keys()
        union |= {file: (folder / file).read_bytes() for file in files}
    whole = tmp_path / "whole"
    answers = {file for file in files_in(whole) if Path(file).parent.name in KINDS}
    assert len(answers) == N * len(KINDS)
    assert union == {file: (whole / file).read_bytes() for file in answers}


def test_a_shard_is_of_the_frames_within_the_limit(tmp_path, run):
    assert run("--limit", 5, "--shard", "2/2").exit_code == 0
    assert [row["name"] for row in rows_of(tmp_path / "out")] == ["f1", "f3"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["inputs"]["shard"] == "2/2"


def test_the_limit(tmp_path, run):
    assert run("--limit", 3).exit_code == 0
    assert len(rows_of(tmp_path / "out")) == 3


@pytest.mark.parametrize(
    ("save", "folders"),
    [("none", set()), ("depth,semantic", {"depth", "semantic"}), ("overlay", {"overlay"})],
)
def test_what_is_saved(tmp_path, run, save, folders):
    result = run("--save", save)
    assert result.exit_code == 0
    assert {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()} == folders
    assert len(rows_of(tmp_path / "out")) == N
    assert ("pictures:" in result.stdout) == ("overlay" in folders)


def test_all_that_is_saved_is_what_the_model_answers(tmp_path, stream, model_file):
    given = arguments(stream, model_file(heads=("semantic", "depth")), tmp_path)
    result = CliRunner().invoke(app, [*given, "--limit", "1", "--json"])
    assert json.loads(result.stdout)["saved"] == ["semantic", "depth", "overlay"]
    folders = {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()}
    assert folders == {"semantic", "depth", "overlay"}


def test_what_the_model_does_not_answer_cannot_be_saved(tmp_path, stream, model_file):
    given = arguments(stream, model_file(heads=("semantic", "depth")), tmp_path)
    result = CliRunner().invoke(app, [*given, "--save", "depth,uncertainty"])
    assert result.exit_code == 1
    assert "asks for uncertainty, the model by-hand answers semantic, depth" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_missed_deadline_is_exit_code_4(tmp_path, run, stream):
    (stream[1] / "f3.png").unlink()
    result = run("--deadline-ms", 1e-6)
    assert result.exit_code == 4, "the gate outranks the skipped frame"
    assert "missed deadlines of 1e-06 ms: 11, longest run 11" in result.stdout
    late = [row["missed_deadline"] for row in rows_of(tmp_path / "out")]
    assert late == ["1"] * 3 + [""] + ["1"] * 8


def test_answers_that_cannot_be_used_are_exit_code_3(tmp_path, run, stream):
    black = np.zeros((48, 64, 3), np.uint8)  # green / blue of the model by hand: 0 / 0
    for path in stream[0].iterdir():
        cv2.imwrite(str(path), black)
    result = run()
    assert result.exit_code == 3
    assert "(12 invalid)" in result.stdout
    assert "pictures:" not in result.stdout
    assert not list((tmp_path / "out/overlay").iterdir())


def test_depth_beyond_the_range_of_a_png_is_reported(tmp_path, stream, model_file, contract):
    assert "note:" not in CliRunner().invoke(app, arguments(stream, model_file(), tmp_path)).stdout
    far = model_file(contract=dataclasses.replace(contract, max_depth_m=400.0))
    result = CliRunner().invoke(app, arguments(stream, far, tmp_path / "far"))
    assert "depth reaches 400 m, a depth PNG 256.00 m" in result.stdout
    report = json.loads((tmp_path / "far/out/report.json").read_text())
    assert report["depth_png"] == {"units_per_metre": 256, "max_m": 65535 / 256}


def test_without_warm_up_no_first_inference_is_reported(tmp_path, run):
    assert "first inference n/a" in run("--warmup", 0).stdout


def test_the_demo_runs_the_bundled_stream(tmp_path, stream, model_file, monkeypatch):
    bundled = tmp_path / "assets" / "stream"
    bundled.mkdir(parents=True)
    arguments = ["--demo", "--model", str(model_file()), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(runtime.sources.bundled_stream.resources, "files", lambda package: tmp_path)
    empty = CliRunner().invoke(app, arguments)
    assert empty.exit_code == 1
    stream[0].rename(bundled / "rgb")
    stream[1].rename(bundled / "depth")
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert len(rows_of(tmp_path / "out")) == N
    inputs = json.loads((tmp_path / "out/report.json").read_text())["inputs"]
    assert inputs["focal_length_px"] == pytest.approx(483.35, abs=0.01)  # of the rendered camera


def test_a_missing_bundled_stream_is_an_error(tmp_path, model_file, monkeypatch):
    monkeypatch.setattr(runtime.sources.bundled_stream.resources, "files", lambda package: tmp_path)
    result = CliRunner().invoke(app, ["--demo", "--out", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert "bundled stream" in result.stderr


# --- bad input ---------------------------------------------------------------------------------


def test_skipped_frames_are_counted_named_and_exit_code_3(tmp_path, run, stream, monkeypatch):
    rgb, depth = stream
    drawn: dict[int, float] = {}
    draw = runtime.run.report_files.draw_latency

    def spy(latencies_ms, **options):
        drawn.update(latencies_ms)
        return draw(latencies_ms, **options)

    monkeypatch.setattr(runtime.run.report_files, "draw_latency", spy)
    (depth / "f1.png").unlink()
    (rgb / "f2.png").unlink()
    picture = rgb / "f4.png"
    picture.write_bytes(picture.read_bytes()[:700])
    cv2.imwrite(str(depth / "f6.png"), np.zeros((48, 64), np.uint8))
    cv2.imwrite(str(depth / "f8.png"), np.zeros((40, 64), np.uint16))
    result = run()
    assert result.exit_code == 3
    assert "frames: 12 (7 ok, 5 skipped)" in result.stdout
    rows = {row["name"]: row for row in rows_of(tmp_path / "out")}
    reasons = {
        "f1": "no depth map",
        "f2": "no image",
        "f4": "truncated",
        "f6": "got uint8",
        "f8": "(40, 64)",
    }
    assert {name for name, row in rows.items() if row["status"] == "skipped"} == set(reasons)
    for name, reason in reasons.items():
        assert reason in rows[name]["reason"]
        assert re.search(rf"  {name}: skipped: .*{re.escape(reason)}", result.stdout)
        assert rows[name]["predict_ms"] == ""
    written = {p.stem for p in (tmp_path / "out/overlay").iterdir()}
    assert written == rows.keys() - reasons.keys()
    assert {f"f{index}" for index in drawn} == written


def test_a_first_frame_that_is_damaged_does_not_matter_to_the_warm_up(run, stream):
    (stream[0] / "f0.png").write_bytes(b"")
    result = run()
    assert result.exit_code == 3
    assert "11 ok" in result.stdout


def test_only_the_first_few_frames_are_read_to_warm_up(run, stream, monkeypatch):
    for picture in stream[0].iterdir():
        picture.write_bytes(b"")
    read = []
    read_rgb = runtime.sources.folders.read_rgb

    def count(path):
        read.append(path)
        return read_rgb(path)

    monkeypatch.setattr(runtime.sources.folders, "read_rgb", count)
    monkeypatch.setattr(runtime.run.run, "_FIRST_FRAMES", 3)
    assert "none of the first 3 frames" in run().output
    assert len(read) == 3


def test_a_recording_that_cannot_be_made_is_reported_before_anything_is_made(tmp_path, run):
    (tmp_path / "taken").mkdir()
    result = run("--record", tmp_path / "taken")
    assert result.exit_code == 1
    assert f"{tmp_path / 'taken'} exists: choose another name" in result.output
    assert not (tmp_path / "out").exists()


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
    assert "of images of (48, 64)" in skipped[0]["reason"]
    assert len(list((tmp_path / "out/cloud").iterdir())) == N - 1


def test_empty_lidar_frames_are_counted(tmp_path, run, stream):
    for index in (2, 5):
        cv2.imwrite(str(stream[1] / f"f{index}.png"), np.zeros((48, 64), np.uint16))
    result = run()
    assert result.exit_code == 0
    assert "degraded: no_depth: 2" in result.stdout
    assert rows_of(tmp_path / "out")[5]["degraded"] == "no_depth"


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda rgb, depth: [p.unlink() for p in rgb.iterdir()], "has no .png"),
        (lambda rgb, depth: [p.rename(p.with_stem(p.stem + "_d")) for p in depth.iterdir()],
         "no name occurs in both"),
        (lambda rgb, depth: depth.rename(depth.with_name("gone")), "cannot list the folder"),
    ],
    ids=["empty", "no matching names", "missing"],
)  # fmt: skip
def test_folders_that_make_no_stream_are_exit_code_1(tmp_path, run, stream, spoil, text):
    spoil(*stream)
    result = run()
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    assert text in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_pinned_model_is_the_one_that_runs(tmp_path, run):
    assert run().exit_code == 0
    digest = json.loads((tmp_path / "out/report.json").read_text())["model"]["sha256"]
    assert run("--sha256", digest, "--overwrite").exit_code == 0
    for other, text in (("0" * 64, digest), ("abc", "64 hexadecimal digits")):
        result = run("--sha256", other, "--overwrite")
        assert result.exit_code == 1
        assert text in result.stderr


def test_a_model_by_its_name(tmp_path, run):
    assert run("--model", "ssdnet-lite").exit_code == 0
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["model"]["path"].endswith("assets/ssdnet-lite.onnx")
    result = run("--model", "ssdnet-huge", "--overwrite")
    assert result.exit_code == 1
    assert "no bundled model is called 'ssdnet-huge'; there are: " in result.stderr


def test_a_bad_model_is_exit_code_1_and_leaves_an_earlier_run_alone(tmp_path, run):
    assert run().exit_code == 0
    before = files_in(tmp_path / "out")
    (tmp_path / "bad.onnx").write_bytes(b"no model")
    result = run("--model", tmp_path / "bad.onnx", "--overwrite")
    assert result.exit_code == 1
    assert "cannot be loaded" in result.stderr
    assert files_in(tmp_path / "out") == before


def test_an_existing_run_needs_overwrite(tmp_path, run):
    assert run("--limit", 5).exit_code == 0
    before = (tmp_path / "out/report.json").read_bytes()
    result = run("--limit", 2)
    assert result.exit_code == 1
    assert "--overwrite" in result.stderr
    assert (tmp_path / "out/report.json").read_bytes() == before
    assert run("--limit", 2, "--overwrite").exit_code == 0
    assert {p.stem for p in (tmp_path / "out/depth").iterdir()} == {"f0", "f1"}


def test_overwrite_never_replaces_a_foreign_file(tmp_path, run):
    assert run("--limit", 2).exit_code == 0
    (tmp_path / "out/depth/f3.png").write_text("mine")
    before = files_in(tmp_path / "out")
    result = run("--overwrite")
    assert result.exit_code == 1
    assert "out/depth/f3.png is not of the earlier run" in result.stderr
    assert files_in(tmp_path / "out") == before
    assert run("--limit", 3, "--overwrite").exit_code == 0
    assert (tmp_path / "out/depth/f3.png").read_text() == "mine"


@pytest.mark.parametrize("kind", ["depth", "semantic"])
def test_answers_are_never_written_where_frames_are_read(tmp_path, run, stream, kind):
    assert run().exit_code == 0
    before = files_in(tmp_path / "out")
    result = run("--depth", tmp_path / "out" / kind, "--overwrite")
    assert result.exit_code == 1
    assert "choose another --out" in result.stderr
    assert files_in(tmp_path / "out") == before


def test_a_name_that_is_no_text(tmp_path, run, stream):
    """File systems take any bytes."""
    for folder in stream:
        (folder / "f3.png").rename(folder / "f\udcff3.png")
    (stream[1] / "f5.png").rename(stream[1] / "g\udcff5.png")
    result = run()
    assert result.exit_code == 3
    assert r"g\udcff5: skipped" in result.stdout
    table = (tmp_path / "out/frames.csv").read_bytes()
    assert b",f\xff3,ok" in table
    assert (tmp_path / "out/depth" / "f\udcff3.png").is_file()
    assert len(json.loads((tmp_path / "out/report.json").read_text())["frames"]["not_ok"]) == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(("option", "code"), [("--overwrite", 0), ("--json", 1)])
def test_a_run_outlives_what_it_prints_to(tmp_path, stream, model_file, option, code):
    command = [
        sys.executable,
        "-m",
        "runtime.run",
        *arguments(stream, model_file(), tmp_path),
    ]
    with open("/dev/full", "w") as full:
        done = subprocess.run([*command, option], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == code
    assert "cannot print (No space left on device): see" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(rows_of(tmp_path / "out")) == N


def test_a_closed_pipe_does_not_stop_the_run(tmp_path, stream, model_file):
    command = [
        sys.executable,
        "-m",
        "runtime.run",
        *arguments(stream, model_file(), tmp_path),
    ]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(rows_of(tmp_path / "out")) == N


def test_a_closed_pipe_does_not_fail_the_exit():
    """More than any buffer holds: the rest is flushed once more at the end."""
    program = "from runtime.command import print_result; print_result('x' * 100_000)"
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_output_folder_that_cannot_be_written(tmp_path, run):
    (tmp_path / "file").touch()
    result = run("--out", tmp_path / "file" / "out")
    assert result.exit_code == 1
    assert "cannot make the output folder" in result.stderr


@pytest.mark.parametrize("share", [0.3, 0.8, 1.0])
def test_a_full_disk_is_exit_code_1_with_whole_files_only(tmp_path, run, mount_disk, share):
    """share: of the room that the pictures take; with all of it the tables find none."""
    assert run().exit_code == 0
    pictures = [path for path in (tmp_path / "out").glob("*/*") if path.is_file()]
    pages = sum(-(-path.stat().st_size // 4096) for path in pictures)
    out = mount_disk(4 * (int(share * pages) + 1)) / "out"  # and the list of the run's own files
    result = run("--out", out)
    assert result.exit_code == 1
    assert "No space left on device" in result.stderr
    left = files_in(out)
    assert not [name for name in left if ".part" in name]
    assert "report.json" not in left
    kinds = [{path.stem for path in (out / kind).iterdir()} for kind in KINDS]
    assert kinds == [kinds[0]] * len(KINDS), "every frame has all of its files or none"
    assert len(kinds[0]) == N if share == 1 else 0 < len(kinds[0]) < N
    assert run("--out", out, "--overwrite", "--limit", 1, "--save", "semantic").exit_code == 0


def test_frames_that_are_skipped_for_one_reason_are_one_line(tmp_path, stream, run):
    rgb, depth = stream
    for name in ("f3", "f4", "f7"):
        (depth / f"{name}.png").unlink()
    (rgb / "f9.png").write_bytes(b"")
    result = run()
    assert result.exit_code == 3
    assert "\n  3 frames, first f3: skipped: f3 has an image, but no depth map\n" in result.stdout
    assert f"\n  f9: skipped: {rgb / 'f9.png'} is empty" in result.stdout
    assert result.stdout.count("skipped:") == 2
    assert [row["name"] for row in rows_of(tmp_path / "out") if row["reason"]] == [
        "f3", "f4", "f7", "f9"
    ]  # fmt: skip


@pytest.mark.parametrize("warmup", [0, 1])
@pytest.mark.parametrize("n", [19, 20])
def test_a_stream_that_is_refused_from_the_start_is_an_error(
    tmp_path, make_stream, all_heads, n, warmup
):
    folders = make_stream(n)
    for path in folders[1].iterdir():
        assert cv2.imwrite(str(path), np.zeros((40, 64), np.uint16))
    given = [*arguments(folders, all_heads, tmp_path), "--warmup", str(warmup)]
    result = CliRunner().invoke(app, given)
    if n < 20:
        assert result.exit_code == 3
        assert f"{n} frames, first f0: skipped: sparse_depth must have the shape" in result.stdout
    else:
        assert result.exit_code == 1
        assert "error: none of the first 20 frames can be predicted" in result.stderr
        assert "20 frames, first f0: sparse_depth must have the shape" in result.stderr
        assert not (tmp_path / "out").exists()


def test_ctrl_c_leaves_a_whole_report_of_what_was_done(tmp_path, run, signal_in_frame_6):
    before = signal.getsignal(signal_in_frame_6)
    result = run("--warmup", 0, "--record", tmp_path / "recording")
    assert result.exit_code == 3
    assert "frames: 7 (7 ok), interrupted" in result.stdout
    assert len(read_recording(tmp_path / "recording").frames) == 7
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["interrupted"]
    assert len(rows_of(tmp_path / "out")) == 7
    assert len(list((tmp_path / "out/overlay").iterdir())) == 7
    assert signal.getsignal(signal_in_frame_6) == before


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--depth", "somewhere"],
        ["--demo", "--depth", "somewhere"],
        ["--rgb", "somewhere", "--source", "folders:somewhere"],
        ["--demo", "--max-skew-ms", "-1"],
        ["--demo", "--rgb", "somewhere"],
        ["--demo", "somewhere"],
        ["somewhere", "--rgb", "somewhere"],
        ["--demo", "--save", "everything"],
        ["--demo", "--save", "depth,all"],
        ["--demo", "--save", "none", "--save", "depth"],
        ["--demo", "--threads", "0"],
        ["--demo", "--limit", "0"],
        ["--demo", "--depth-scale", "0"],
        ["--demo", "--depth-scale", "nan"],
        ["--demo", "--depth-scale", "1e-50"],
        ["--demo", "--deadline-ms", "-1"],
        ["--demo", "--deadline-ms", "1.5e308"],
        ["--demo", "--provider", "gpu"],
        ["--demo", "--warmup", "-1"],
        ["--demo", "--video", "out.avi"],
        ["--demo", "--shard", "0/4"],
        ["--demo", "--shard", "5/4"],
        ["--demo", "--shard", "1"],
        ["--demo", "--shard", "-1/4"],
        ["--demo", "--shard", "1/9999999"],
        ["--no-such-option"],
    ],
)
def test_wrong_usage_is_exit_code_2(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2, result.output
    assert not list(tmp_path.iterdir())


def test_a_second_run_has_a_folder_of_its_own(tmp_path, stream, all_heads, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rgb, depth = stream
    given = ["--rgb", rgb, "--depth", depth, "--limit", 1, "--save", "none", "--model", all_heads]
    for name in ("ssdnet-run", "ssdnet-run-2", "ssdnet-run-3"):
        result = CliRunner().invoke(app, [str(a) for a in given])
        assert result.exit_code == 0, result.output
        assert f"results: {tmp_path / name}\n" in result.stdout
        assert (tmp_path / name / "report.json").exists()
    replaced = CliRunner().invoke(app, [str(a) for a in [*given, "--overwrite"]])
    assert f"results: {tmp_path / 'ssdnet-run'}\n" in replaced.stdout
    refused = CliRunner().invoke(app, [str(a) for a in [*given, "--out", "ssdnet-run"]])
    assert (refused.exit_code, "is not empty" in refused.stderr) == (1, True)


def test_saved_kinds_add_up(tmp_path, run):
    asked = ["--save", "overlay", "--save", "semantic,depth"]
    assert run("--limit", 1, *asked).exit_code == 0
    folders = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert folders == {"overlay", "semantic", "depth"}


def test_the_bundled_models_are_listed():
    """With size, work and accuracy, and what these were measured on."""
    result = CliRunner().invoke(app, ["--list-models"])
    assert result.exit_code == 0
    heading, *lines = result.stdout.splitlines()
    assert heading.split() == ["model", "MB", "GMACs", "mIoU", "%", "MAE", "mm"]
    rows = {name: [float(cell) for cell in cells] for name, *cells in map(str.split, lines[:4])}
    assert list(rows) == list_bundled_models()
    for name, (megabytes, giga_macs, miou, mae_mm) in rows.items():
        path = find_model(name)
        assert megabytes == pytest.approx(path.stat().st_size / 1e6, abs=0.06)
        assert giga_macs == pytest.approx(6.43 if "lite" in name else 2.05, abs=0.06)
        measured = load_model_file(path).contract.accuracy["rows"]
        assert [miou / 100, None] in [
            [round(row["miou"], 3), row["mae_m"]] for row in measured if row["miou"]
        ]
        assert mae_mm in [round(1000 * row["mae_m"]) for row in measured if row["mae_m"]]
    assert lines[4:7] == [
        "GMACs of a frame of 512 x 1024",
        "mIoU % on camvid split=val, LiDAR none",
        "MAE mm on kitti_streets first=70 last=98, LiDAR own",
    ]
    assert Path(lines[7].partition(": ")[2]).is_file()


def test_help_needs_no_onnxruntime(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    result = CliRunner().invoke(app, ["--help"])
    assert result.exit_code == 0
    for option in ("--rgb", "--depth", "--demo", "--depth-scale", "--deadline-ms", "--overwrite"):
        assert option in result.stdout
    assert "Exit codes" in result.stdout


def test_without_onnxruntime_the_commands_are_printed(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    result = run()
    assert result.exit_code == 1
    assert 'pip install "ssdnet[cpu]"' in result.stderr


def test_the_focal_length_reaches_the_model(tmp_path, run, model_file, contract):
    """The graph adds 1.5 canonical metres: 3 m behind a lens twice as long."""
    path = model_file("c.onnx", contract=dataclasses.replace(contract, canonical_focal_px=100.0))
    result = run("--model", path, "--focal-length", 200)
    assert result.exit_code == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["model"]["canonical_focal_px"] == 100.0
    assert report["inputs"]["focal_length_px"] == 200.0
    assert report["inputs"]["used_focal_length_px"] == 200.0
    assert report["inputs"]["depth_range_m"] == 160.0
    assert "focal length 200 px; depth up to 160 m\n" in result.stdout
    picture = next((tmp_path / "out" / "depth").iterdir())
    assert cv2.imread(str(picture), cv2.IMREAD_UNCHANGED).min() == 3 * 256


def test_a_focal_length_that_is_not_known_or_not_used_is_reported(run):
    arguments = ["--limit", 1, "--save", "none"]
    assert "\nfocal length not known; depth up to 80 m\n" in run(*arguments).stdout
    given = run(*arguments, "--focal-length", 200, "--overwrite").stdout
    assert "\nfocal length 200 px, not used by this model; depth up to 80 m\n" in given


@pytest.mark.parametrize("value", ["0", "-5", "nan", "1e9"])
def test_a_focal_length_out_of_range_is_a_usage_error(run, value):
    result = run("--focal-length", value)
    assert result.exit_code == 2
    assert "--focal-length must be a number from 1 to 1e+06" in result.output


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_does_not_end_the_run(tmp_path, stream, model_file, closed):
    command = [sys.executable, "-m", "runtime.run", *arguments(stream, model_file(), tmp_path)]
    done = subprocess.run(["sh", "-c", f"exec {shlex.join(command)} {closed}"])
    assert done.returncode == 0
    assert len(rows_of(tmp_path / "out")) == N
    assert len(list((tmp_path / "out" / "depth").iterdir())) == N


@pytest.mark.parametrize(
    "options",
    [
        ["--record", "a", "--out", "a"],
        ["--record", "a", "--out", "a/b"],
        ["--record", "a/b", "--out", "a"],
        ["--record", "link/a", "--out", "a"],
        ["--record", "a", "--video", "a/b.mp4"],
    ],
)
def test_a_recording_apart_from_other_results_is_required_before_the_run(
    tmp_path, stream, run, monkeypatch, options
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    before = files_in(tmp_path)
    result = run(*options)
    assert result.exit_code == 2
    assert "--record" in result.output
    assert files_in(tmp_path) == before


def test_a_link_that_leads_to_itself_is_an_error(tmp_path, run):
    (tmp_path / "loop").symlink_to("loop")
    for options in (
        ["--out", tmp_path / "loop"],
        ["--out", tmp_path / "loop" / "out"],
        ["--video", tmp_path / "loop" / "a.mp4"],
        ["--record", tmp_path / "loop" / "recording"],
    ):
        result = run(*options)
        assert result.exit_code == 1, options
        assert result.stderr.startswith("error: "), options


@pytest.mark.parametrize("option", ["--out", "--video", "--record"])
def test_a_name_that_is_too_long_is_an_error(tmp_path, run, option):
    name = "n" * 256 + (".mp4" if option == "--video" else "")
    result = run(option, tmp_path / name)
    assert result.exit_code == 1, result.exception
    assert "too long" in result.stderr


@pytest.mark.parametrize("shard", ["1/" + "9" * 5000, "9" * 5000 + "/1", "1/\N{SUPERSCRIPT TWO}"])
def test_a_shard_of_odd_digits_is_a_usage_error(run, shard):
    result = run("--shard", shard)
    assert result.exit_code == 2, result.exception
    assert "--shard is I/N" in result.output
