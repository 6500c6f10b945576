"""ssdnet-bench: models side by side, each with its figures or with the reason why it has none."""

import os
import signal
import sys
import threading
import time

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from typer.testing import CliRunner

from runtime.app.tools import bench_worker
from runtime.app.tools.bench import app
from runtime.command.machine import machine_facts

PROGRAM = "from runtime.app.tools.commands import bench; bench()"


@pytest.fixture
def run(bench_in_threads):
    """Run the command: its result, and the cells of its tables, the titles first."""

    def call(*arguments):
        words = ["--rounds", 2, "--threads", 1, "--size", "32x48", *arguments]
        result = CliRunner().invoke(app, [str(word) for word in words])
        assert result.exception is None or isinstance(result.exception, SystemExit), result
        return result, cells_of(result.output)

    return call


def cells_of(output):
    lines = [line for line in output.splitlines() if line.startswith("| ") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def write_convolution(path):
    """An ONNX file that is none of ours: 8 channels at half the size of 32 x 48."""
    node = helper.make_node("Conv", ["x", "w"], ["y"], strides=[2, 2], pads=[1] * 4)
    graph = helper.make_graph(
        [node],
        "foreign",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, (1, 3, 32, 48))],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(np.ones((8, 3, 3, 3), np.float32), "w")],
    )
    opsets = [helper.make_opsetid("", 18)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=9)
    path.write_bytes(model.SerializeToString())
    return path


def test_our_model_and_a_foreign_one_stand_side_by_side(run, model_file, tmp_path):
    foreign = write_convolution(tmp_path / "foreign|one.onnx")
    result, cells = run(model_file(), foreign, "--size", "64x96", "--batch", 2, "--batch", 3)
    assert result.exit_code == 0, result.output
    first = result.output.splitlines()[0]
    assert machine_facts().processor in first
    assert "2 runs in turn" in first
    cases = [line for line in result.output.splitlines() if line.startswith("**")]
    sizes = [f"{size}, threads 1, batch {n}" for size in ("32 x 48", "64 x 96") for n in (2, 3)]
    assert cases == [f"**{case}**" for case in sizes]
    titles, ours, theirs, _, more, _, _, large, *_ = cells
    assert len(titles) == len(ours) == len(theirs) == 10
    assert (ours[1], more[1], large[1]) == ("2x32x48x3", "3x32x48x3", "2x64x96x3")
    assert ours[4:6] == ["1.00", "1.00 to 1.00"]
    assert theirs[:2] == [f"{tmp_path}/foreign\\|one.onnx", "1x3x32x48"]
    assert (ours[9], theirs[9]) == ("", "its own size, its own batch")
    assert all(float(cell) > 0 for cell in (theirs[2], theirs[4], *theirs[6:9]))
    assert theirs[3] == "-", "of two runs there is no 99th percentile"


def test_what_cannot_run_is_a_row_with_its_reason(run, model_file, tmp_path):
    noise = tmp_path / "noise.onnx"
    noise.write_bytes(b"\x08noise")
    elsewhere = model_file("elsewhere.onnx", only_runs_at=(64, 96))
    cut = model_file("cut.onnx")
    cut.write_bytes(cut.read_bytes()[:-40])
    models = [tmp_path / "none.onnx", noise, "ssdnet-huge", elsewhere, cut, model_file()]
    result, (titles, *rows) = run(*models)
    assert result.exit_code == 1
    reasons = ["No such file", "cannot be loaded", "bundled model", "Add", "damaged", ""]
    for row, reason in zip(rows, reasons, strict=True):
        assert reason in row[9]
        assert (row[2] == "-") == bool(reason)
    assert titles[4] == f"ratio to {models[-1]}", "the first that ran"
    assert rows[-1][5] == "1.00 to 1.00"


def test_weights_beside_a_foreign_model_are_read(run, tmp_path):
    """PyTorch writes them to such a file; our own models are one file."""
    path = write_convolution(tmp_path / "foreign.onnx")
    model = onnx.load(path)
    onnx.save(
        model, path, save_as_external_data=True, location="foreign.onnx.data", size_threshold=0
    )
    result, (_, row) = run(path)
    assert result.exit_code == 0, result.output
    assert row[1] == "1x3x32x48"
    (tmp_path / "foreign.onnx.data").unlink()
    result, (_, row) = run(path)
    assert result.exit_code == 1
    assert "which cannot be read" in row[9]


def test_models_take_turns_after_runs_that_do_not_count(run, model_file, monkeypatch):
    order = []

    def record(run, frames):
        order.append((threading.get_ident(), frames))
        return [float(len(order))] * frames

    monkeypatch.setattr(bench_worker, "time_runs", record)
    _, (_, first, second) = run(model_file(), model_file(), "--rounds", 3)
    a, b = order[0][0], order[1][0]
    assert [ident for ident, _ in order] == [a, b] * 5
    assert [frames for _, frames in order] == [2] * 4 + [1] * 6
    assert (first[2], second[2]) == ("7.00", "8.00")  # medians of 5, 7, 9 and 6, 8, 10
    assert second[4:6] == ["1.14", "1.13 to 1.17"]  # of 6 / 5, 8 / 7, 10 / 9


def test_a_failure_between_the_runs_takes_one_row_alone(run, model_file, monkeypatch):
    real, calls = bench_worker.time_runs, iter(range(100))

    def fail(*arguments):
        if next(calls) == 4:  # 2 are opened and warmed up, then the first one
            raise MemoryError("too much")
        return real(*arguments)

    monkeypatch.setattr(bench_worker, "time_runs", fail)
    result, (titles, failed, good) = run(model_file("a.onnx"), model_file("b.onnx"))
    assert result.exit_code == 1
    assert failed[9] == "out of memory, choose a smaller size or fewer frames (too much)"
    assert (good[4], "b.onnx" in titles[4]) == ("1.00", True)


def test_ctrl_c_prints_what_there_is(run, model_file, monkeypatch):
    real, calls = bench_worker.time_runs, iter(range(100))

    def interrupted(*arguments):
        if next(calls) == 8:  # 2 are opened and warmed up, then 4 runs
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
        return real(*arguments)

    monkeypatch.setattr(bench_worker, "time_runs", interrupted)
    result, cells = run(model_file(), model_file(), "--rounds", 9, "--size", "64x96")
    assert result.exit_code == 130
    assert "9 runs in turn, interrupted" in result.output
    assert [float(row[2]) > 0 for row in cells[1:]] == [True, True]


@pytest.mark.parametrize("options", [["--size", "32"], ["--size", "0x5"], ["--rounds", "0"]])
def test_invalid_options_are_usage_errors(run, options):
    assert run("ssdnet-lite", *options)[0].exit_code == 2


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_each_model_has_a_process_that_ctrl_c_ends_after_the_command(start_process, model_file):
    """As a terminal sends it, to the whole group, of which the command alone acts."""
    options = ["--size", "32x48", "--threads", 1, "--rounds"]
    command = [sys.executable, "-c", PROGRAM, "ssdnet-nano", model_file(), *options]
    stdout, stderr = start_process(*command, 2).communicate()
    _, nano, small = cells_of(stdout)
    assert stderr == ""
    assert float(nano[6]) > float(small[6]) > 20, "each has its own peak of memory"

    process = start_process(*command, 10**8)
    time.sleep(5)
    os.killpg(process.pid, signal.SIGINT)
    stdout, stderr = process.communicate()
    assert (process.returncode, stderr) == (130, "")
    assert len(cells_of(stdout)) == 3
