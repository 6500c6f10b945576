"""What ssdnet-run prints and reports of a run, and its exit code."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cli_runs import COMMAND, N, arguments, rows_of
from runtime.app.run.options import KINDS, SUFFIXES
from runtime.verification.reference import read_reference

NAMES = [f"f{index}" for index in range(N)]


@pytest.fixture
def whole(tmp_path, run):
    """The result of a run over all frames, the rows of frames.csv, and report.json."""
    result = run("--deadline-ms", 60_000, "--warmup", 2)
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    return result, rows_of(out), json.loads((out / "report.json").read_text())


def test_a_run_saves_each_kind_and_prints_the_model_and_the_pictures(tmp_path, whole):
    result, out = whole[0], tmp_path / "out"
    for kind, suffix in SUFFIXES.items():
        written = [path.name for path in (out / kind).glob("*")]
        assert sorted(written) == sorted(name + suffix for name in NAMES if kind in KINDS)
    first_line, *_, last_line = result.stdout.strip().splitlines()
    model = r"by-hand sha256:[0-9a-f]{12} \| CPUExecutionProvider [1-9]\d* nodes \| threads 1"
    assert re.match(rf"{model} \| frames 48 x 64, network at 48 x 64$", first_line)
    assert last_line == f"pictures: {out / 'overlay'}"
    assert "constant stream" not in result.stdout
    assert "missed deadlines of 60000 ms: 0, longest run 0" in result.stdout


def test_the_rows_and_the_report_of_a_run_hold_its_facts(whole):
    _, rows, report = whole
    assert [row["name"] for row in rows] == NAMES, "natural order"
    cells = {"status": "ok", "height": "48", "width": "64", "missed_deadline": "0"}
    cells |= {"age_ms": "", "jitter_ms": ""}
    assert all({name: row[name] for name in cells} == cells for row in rows)
    assert (report["format"], report["version"]) == ("ssdnet-run", "2.0")
    assert (report["frames"]["total"], report["frames"]["by_status"]) == (N, {"ok": N})
    assert report["depth_png"] == {
        "units_per_metre": 256, "max_m": 65535 / 256, "beyond": {"depth": 0, "uncertainty": 0}
    }  # fmt: skip
    assert (report["provider"]["threads"], len(report["model"]["sha256"])) == (1, 64)
    assert report["provider"]["nodes"]["CPUExecutionProvider"] > 5
    assert report["deadline"] == {"deadline_ms": 60_000, "count": 0, "longest_run": 0}
    assert min(report["load_ms"], report["first_inference_ms"]) > 0
    assert report["frames_per_second"] == pytest.approx(N / report["wall_s"])


def test_the_times_that_are_printed_are_those_of_the_rows_and_of_the_report(whole):
    result, rows, report = whole
    stages = ("read", "preprocess", "inference", "postprocess", "predict", "write")
    assert tuple(report["stages"]) == stages
    for stage, statistics in report["stages"].items():
        times = [float(row[f"{stage}_ms"]) for row in rows]
        assert (statistics["n"], statistics["p99_ms"]) == (N, None)
        assert statistics["mean_ms"] == pytest.approx(np.mean(times), abs=1e-3)
        assert statistics["max_ms"] == pytest.approx(max(times), abs=1e-3)
        assert statistics["median_ms"] == pytest.approx(sorted(times)[N // 2 - 1], abs=1e-3)
        (line,) = re.findall(rf"^{stage} .*$", result.stdout, re.MULTILINE)
        assert float(line.split()[3]) == pytest.approx(statistics["median_ms"], abs=6e-3)
    for row in rows:
        parts = sum(float(row[f"{stage}_ms"]) for stage in stages[1:4])
        assert float(row["predict_ms"]) >= parts - 0.002, "three rounded times"


def test_a_constant_stream_reports_age_and_jitter_and_late_frames(tmp_path, run, stream):
    (stream[1] / "f3.png").unlink()
    result = run("--rate", 10_000, "--deadline-ms", 1e-3)  # due long before they can be done
    assert result.exit_code == 4, "a late frame outranks the skipped one"
    assert "constant stream of 10000 Hz" in result.stdout
    assert "missed deadlines of 0.001 ms: 11, longest run 11" in result.stdout
    assert re.search(r"^age +\d.*\n^jitter +\d", result.stdout, re.MULTILINE)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    overload = "10000 frames a second are more than this machine answers"
    assert f"warning: {overload}" in result.stderr
    scenario = report["scenario"]
    assert scenario.pop("overload").startswith(overload)
    assert scenario == {"name": "constant-stream", "rate_hz": 10_000}
    rows = rows_of(tmp_path / "out")
    assert [row["missed_deadline"] for row in rows] == ["1"] * 3 + [""] + ["1"] * 8
    ages = [float(row["age_ms"]) for row in rows if row["age_ms"]]
    assert (report["stages"]["age"]["n"], report["deadline"]["count"]) == (N - 1, N - 1)
    assert report["stages"]["age"]["max_ms"] == pytest.approx(max(ages), abs=1e-3)
    assert float(rows[1]["jitter_ms"]) == pytest.approx(abs(ages[1] - ages[0]), abs=2e-3)
    assert all(float(row["age_ms"] or 1e9) > float(row["predict_ms"] or 0) for row in rows)


def test_ctrl_c_leaves_whole_outputs_of_what_was_done(tmp_path, run, read_page, signal_in_frame_6):
    before = signal.getsignal(signal_in_frame_6)
    recording, page = tmp_path / "recording", tmp_path / "report.html"
    result = run("--warmup", 0, "--record", recording, "--page", page)
    assert result.exit_code == 3
    assert "frames: 7 (7 ok), interrupted" in result.stdout
    assert len(read_reference(recording).frames) == 7
    assert {"interrupted", "7 ok"} <= set(read_page(page.read_text()).texts)
    assert json.loads((tmp_path / "out/report.json").read_text())["interrupted"]
    assert len(rows_of(tmp_path / "out")) == 7
    assert len(list((tmp_path / "out/overlay").iterdir())) == 7
    assert signal.getsignal(signal_in_frame_6) == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("is_full", [True, False])
def test_a_full_stdout_is_an_error_and_a_closed_one_is_none(tmp_path, stream, model_file, is_full):
    command = [sys.executable, "-c", COMMAND, *arguments(stream, model_file(), tmp_path)]
    command += ["--limit", "1"]
    reader, closed_pipe = os.pipe()
    os.close(reader)
    with open("/dev/full", "w") as full, open(closed_pipe, "w") as pipe:
        stdout = full if is_full else pipe
        done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True)
    error = "error: cannot print (No space left on device): redirect the output\n"
    assert (done.returncode, done.stderr) == ((1, error) if is_full else (0, ""))
    assert is_full or len(rows_of(tmp_path / "out")) == 1
