"""What ssdnet-run prints and reports of a run, and its exit code."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from cli_runs import COMMAND, N, arguments, rows_of
from runtime.io.recording import read_recording
from runtime.run.cli import app


def test_a_run_from_end_to_end(tmp_path, run):
    result = run("--deadline-ms", 60_000)
    assert result.exit_code == 0, result.output
    assert "constant stream" not in result.stdout
    assert not re.search(r"^(age|jitter) ", result.stdout, re.MULTILINE)
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


def test_the_rows_and_the_report_agree(tmp_path, run):
    run("--deadline-ms", 60_000, "--warmup", 2)
    rows = rows_of(tmp_path / "out")
    assert [row["name"] for row in rows] == [f"f{index}" for index in range(N)], "natural order"
    assert {row["status"] for row in rows} == {"ok"}
    assert {(row["height"], row["width"]) for row in rows} == {("48", "64")}
    assert {row["missed_deadline"] for row in rows} == {"0"}
    assert {row["age_ms"] + row["jitter_ms"] for row in rows} == {""}
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert (report["format"], report["version"]) == ("ssdnet-run", "2.0")
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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_closed_pipe_is_no_error_and_a_full_disk_is_one(tmp_path, stream, model_file):
    command = [sys.executable, "-c", COMMAND, *arguments(stream, model_file(), tmp_path)]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    error = "error: cannot print (No space left on device): redirect the output\n"
    assert (done.returncode, done.stderr) == (1, error)
    reader, writer = os.pipe()
    os.close(reader)
    command.append("--overwrite")
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(rows_of(tmp_path / "out")) == N
