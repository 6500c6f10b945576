"""ssdnet-bench: models side by side, each with its figures or with the reason why it has none."""

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper
from typer.testing import CliRunner

from runtime import Predictor
from runtime.errors import ContractError, InputError
from runtime.tools import bench, bench_cli, bench_worker
from runtime.tools.bench_cli import app

SIZE = (32, 48)
FREE, FIXED = (1, "rows", "height", "width"), (1, 3, 32, 48)


@pytest.fixture
def run(bench_in_threads, tmp_path):
    """Run the command: its result, and its JSON."""
    path = tmp_path / "bench.json"

    def call(*arguments):
        words = ["--rounds", 2, "--threads", 1, "--size", "32x48", "--json", path, *arguments]
        result = CliRunner().invoke(app, [str(word) for word in words])
        assert result.exception is None or isinstance(result.exception, SystemExit), result
        return result, json.loads(path.read_text()) if path.exists() else None

    return call


def rows_of(document):
    return [row for group in document["groups"] for row in group]


def cells_of(output):
    """Cells of the rows of all tables, the titles first."""
    lines = [line for line in output.splitlines() if line.startswith("| ") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def write_foreign(path, inputs, nodes, weights=(), opset=18):
    """Write an ONNX file that is none of ours: input -> shape, all float; the output is "y"."""
    graph = helper.make_graph(
        nodes,
        "foreign",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, shape) for n, shape in inputs.items()],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(np.ones(s, np.float32), n) for n, s in dict(weights).items()],
    )
    opsets = [helper.make_opsetid("", opset)]
    path.write_bytes(
        helper.make_model(graph, opset_imports=opsets, ir_version=9).SerializeToString()
    )
    return path


def write_convolution(path, shape=(1, 3, 32, 48)):
    """8 channels at half the size."""
    node = helper.make_node("Conv", ["x", "w", "b"], ["y"], strides=[2, 2], pads=[1] * 4)
    return write_foreign(path, {"x": shape}, [node], {"w": (8, 3, 3, 3), "b": (8,)})


def test_our_model_and_a_foreign_one_stand_side_by_side(run, model_file, tmp_path):
    foreign = write_convolution(tmp_path / "foreign|one.onnx")
    options = ["--size", "64x96", "--batch", 2, "--batch", 3]
    result, document = run(model_file(), foreign, *options)
    assert result.exit_code == 0, result.output
    first = result.output.splitlines()[0]
    assert bench.machine_facts().processor in first
    assert "2 runs in turn" in first
    for case in ("32 x 48", "64 x 96"):
        assert f"**{case}, threads 1, batch 2**" in result.output
        assert f"**{case}, threads 1, batch 3**" in result.output
    titles, ours, theirs, _, more, _, _, large, *_ = cells_of(result.output)
    assert len(titles) == len(ours) == len(theirs) == 12
    assert (ours[1], more[1], large[1]) == ("2x32x48x3", "3x32x48x3", "2x64x96x3")
    assert theirs[1] == "1x3x32x48"
    assert (ours[5], ours[6], ours[11]) == ("1.00", "1.00 to 1.00", "")
    assert theirs[0] == f"{tmp_path}/foreign\\|one.onnx"
    assert theirs[11] == "its own size, its own batch"
    assert all(float(cell) > 0 for cell in (*theirs[2:4], theirs[5], *theirs[7:11]))
    assert theirs[4] == "-", "of two runs there is no 99th percentile"

    rows = rows_of(document)
    assert document["format"] == "ssdnet-bench"
    assert document["machine"]["instruction_sets"] == [*bench.machine_facts().instruction_sets]
    assert [row["size"] for row in rows] == [[32, 48]] * 4 + [[64, 96]] * 4
    assert [row["batch"] for row in rows] == [2, 2, 3, 3] * 2
    assert rows[0]["opened"]["shapes"]["sparse_depth"] == [2, 32, 48]
    for row in rows:
        assert len(row["times_ms"]) == 2
        figures, (latencies, worked) = row["figures"], zip(*row["times_ms"], strict=True)
        assert figures["min_ms"] == min(latencies)
        assert figures["latency"]["n"] == 2
        assert figures["processor_ms"] == pytest.approx(sum(worked) / 2)


def test_what_cannot_run_is_a_row_with_its_reason(run, model_file, tmp_path):
    noise = tmp_path / "noise.onnx"
    noise.write_bytes(b"\x08noise")
    elsewhere = model_file("elsewhere.onnx", only_runs_at=(64, 96))
    models = [tmp_path / "none.onnx", noise, "ssdnet-huge", elsewhere, model_file()]
    result, document = run(*models)
    assert result.exit_code == 1
    notes = [cells[11] for cells in cells_of(result.output)[1:]]
    for note, reason in zip(
        notes, ["No such file", "cannot be loaded", "bundled model", "Add", ""], strict=True
    ):
        assert reason in note
    assert [row["error"] is None for row in rows_of(document)] == [False] * 4 + [True]
    good = rows_of(document)[-1]["figures"]
    assert good["min_ms"] > 0
    assert good["ratio"] == [1, 1, 1], "it is the first that ran"
    assert cells_of(result.output)[0][5] == f"ratio to {models[-1]}"


@pytest.mark.parametrize("damage", ["flipped", "cut", "zipped", "empty"])
def test_a_damaged_model_is_refused_as_the_engine_refuses_it(run, model_file, damage):
    """A changed byte ran as if nothing had happened; a checkpoint, a zip archive, was damaged."""
    path = model_file()
    content = path.read_bytes()
    middle = content.index(b"by_hand")
    path.write_bytes(
        {
            "flipped": content[:middle] + b"B" + content[middle + 1 :],
            "cut": content[:-40],
            "zipped": b"PK" + content,
            "empty": b"",
        }[damage]
    )
    with pytest.raises(ContractError) as refused:
        Predictor(path)
    result, document = run(path)
    assert result.exit_code == 1
    assert [row["error"] for row in rows_of(document)] == [str(refused.value)]


def test_a_failure_between_the_runs_takes_the_row_and_leaves_the_others(
    run, model_file, monkeypatch
):
    calls = []
    real = bench_worker.time_runs

    def fail(run, frames, period_s):
        calls.append(threading.current_thread())
        if len(calls) == 7:  # 3 are opened and warmed up, then the first one
            raise MemoryError("too much")
        if len(calls) == 11:  # the third one in its second round: its process ends
            raise EOFError
        return real(run, frames, period_s)

    monkeypatch.setattr(bench_worker, "time_runs", fail)
    result, document = run(model_file(), model_file(), model_file(), "--rounds", 3)
    assert result.exit_code == 1
    errors = [
        "out of memory, choose a smaller size or fewer frames (too much)",
        None,
        "its process ended with exit code 3",
    ]
    assert [row["error"] for row in rows_of(document)] == errors
    assert [len(row["times_ms"]) for row in rows_of(document)] == [0, 3, 0]
    assert rows_of(document)[1]["figures"]["ratio"] == [1, 1, 1], "it is the first that ran"


def test_models_take_turns_after_runs_that_do_not_count(run, model_file, monkeypatch):
    order = []

    def record(run, frames, period_s):
        order.append((threading.get_ident(), frames, period_s))
        return [(float(len(order)), 1.0)] * frames

    monkeypatch.setattr(bench_worker, "time_runs", record)
    _, document = run(model_file(), model_file(), "--rounds", 3)
    a, b = order[0][0], order[1][0]
    assert [ident for ident, _, _ in order] == [a, b] * 5
    assert [frames for _, frames, _ in order] == [2] * 4 + [1] * 6
    assert rows_of(document)[0]["times_ms"] == [[5.0, 1.0], [7.0, 1.0], [9.0, 1.0]]

    order.clear()
    result, document = run(model_file(), model_file(), "--rounds", 50, "--rate", 20)
    assert "50 frames at 20 Hz" in result.output
    a, b = order[0][0], order[1][0]
    assert order[4:] == [(x, n, 0.05) for n in (20, 20, 10) for x in (a, b)]
    assert [len(row["times_ms"]) for row in rows_of(document)] == [50, 50]


@pytest.mark.parametrize(
    ("period_s", "latencies"),
    [(None, [30, 30, 30]), (0.05, [30, 30, 30]), (0.02, [30, 40, 50])],
)
def test_a_latency_counts_from_when_the_frame_is_due(monkeypatch, period_s, latencies):
    """Each run takes 30 ms."""
    now = [100.0]

    def advance(seconds):
        now[0] += seconds

    clock = SimpleNamespace(
        perf_counter=lambda: now[0], process_time=lambda: now[0] * 2, sleep=advance
    )
    monkeypatch.setattr(bench_worker, "time", clock)
    times_ms = bench_worker.time_runs(lambda: advance(0.03), 3, period_s)
    assert [latency for latency, _ in times_ms] == pytest.approx(latencies)
    assert now[0] == pytest.approx(100.13 if period_s == 0.05 else 100.09)


def test_ratios_are_of_each_round_and_a_p99_is_of_a_hundred_runs():
    """A machine that becomes three times as slow changes times, not ratios."""
    opened = bench_worker.Opened({}, (), 1.0, 1.0, None)
    slow = [1, 3, 1, 1, 3] * 20
    first = bench.BenchRow("a", SIZE, 1, 1, opened, None, [(10.0 * s, 4.0) for s in slow])
    second = bench.BenchRow("b", SIZE, 1, 1, opened, None, [(20.0 * s, 2.0) for s in slow])
    second.times_ms[:40] = [((10 + n) * s, 2.0) for n, s in enumerate(slow[:40])]
    second.times_ms[40:] = [(100.0 * s, 2.0) for s in slow[40:80]]  # then Ctrl-C
    found = bench._figures(second, first)
    assert found.ratio == pytest.approx((2.975, 7.45, 10))
    assert found.processor_ratio == pytest.approx((0.5, 0.5, 0.5))
    assert found.latency.p99_ms is None
    found = bench._figures(first, first)
    assert (found.min_ms, found.latency.median_ms, found.latency.p99_ms) == (10, 10, 30)
    assert bench._figures(bench.BenchRow("c", SIZE, 1, 1), first) is None


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (0.0, "0.00"),
        (0.0431, "0.0431"),
        (1, "1.00"),
        (59.94, "59.9"),
        (1612.3, "1612"),
    ],
)
def test_figures_have_three_digits(value, text):
    assert bench_cli._number(value) == text


def feeds_of(*inputs, batch=1):
    items = [SimpleNamespace(name=n, type=f"tensor({t})", shape=s) for n, t, s in inputs]
    feeds, notes = bench_worker.make_feeds(items, size=SIZE, batch=batch)
    return [values.shape for values in feeds.values()], notes


@pytest.mark.parametrize(
    ("shape", "filled", "notes"),
    [
        (["N", 3, "H", "W"], (4, 3, 32, 48), ()),
        (["batch", None, None, 3], (4, 32, 48, 3), ()),
        ([None, "s1", "s2"], (4, 32, 48), ()),
        (["batch", 3, "image_height", 64], (4, 3, 32, 64), ()),
        ([1, 3, "H", "W"], (1, 3, 32, 48), ("its own batch",)),
        ([2, 3, 64, 64], (2, 3, 64, 64), ("its own size", "its own batch")),
        (["N", "tokens", 8], (4, 1, 8), ("tokens = 1", "its own size")),
        (["width", "height"], (48, 32), ("its own batch",)),
        ([], (), ("its own size", "its own batch")),
    ],
)
def test_free_axes_are_filled_by_their_names_and_places(shape, filled, notes):
    assert feeds_of(("x", "float", shape), batch=4) == ([filled], notes)


def test_inputs_are_noted_together():
    images = ("a", "uint8", ["N", "h", "w", 3]), ("b", "int64", [5])
    assert feeds_of(*images) == ([(1, 32, 48, 3), (5,)], ())


@pytest.mark.parametrize(
    ("element", "dtype", "values"),
    [
        ("uint8", np.uint8, 200),
        ("float", np.float32, 200),
        ("float16", np.float16, 200),
        ("double", np.float64, 200),
        ("int64", np.int64, 1),
        ("bool", np.bool_, 1),
    ],
)
def test_inputs_are_noise_or_one_valid_value(element, dtype, values):
    filled = bench_worker.make_input("x", f"tensor({element})", (50, 50))
    assert (filled.dtype, filled.shape) == (dtype, (50, 50))
    assert len(np.unique(filled)) >= values
    assert filled.any() == (element != "int64")


def test_a_sparse_depth_holds_returns():
    depth = bench_worker.make_input("sparse_depth", "tensor(float)", (1, 100, 100))
    assert 0.04 < (depth > 0).mean() < 0.06
    assert 70 < depth.max() < 80


@pytest.mark.parametrize("element", ["tensor(string)", "seq(tensor(float))", "tensor(bfloat16)"])
def test_other_inputs_are_refused(element):
    with pytest.raises(InputError, match="expected a tensor of numbers"):
        bench_worker.make_input("x", element, (1,))


def test_ctrl_c_prints_what_there_is(run, model_file, monkeypatch, tmp_path):
    calls = []
    real = bench._Worker.run

    def interrupted(worker, frames, period_s):
        calls.append(worker)
        if len(calls) == 6:  # 2 warm-ups, 3 runs
            signal.raise_signal(signal.SIGINT)
        return real(worker, frames, period_s)

    monkeypatch.setattr(bench._Worker, "run", interrupted)
    result, document = run(model_file(), model_file(), "--rounds", 9, "--size", "64x96")
    assert result.exit_code == 130
    assert "9 runs in turn, interrupted" in result.output
    assert [len(row["times_ms"]) for row in rows_of(document)] == [2, 1]
    assert len(document["groups"]) == 1
    assert [cells[11] for cells in cells_of(result.output)[1:]] == ["", ""]


@pytest.mark.parametrize(
    "options",
    [["--size", "32"], ["--size", "0x5"], ["--rate", "0"], ["--rate", "nan"], ["--rounds", "0"]],
)
def test_invalid_options_are_usage_errors(run, options):
    assert run("ssdnet-lite", *options)[0].exit_code == 2


def test_a_file_that_cannot_be_written_is_an_error_before_the_first_run(run, model_file, tmp_path):
    for path, reason in (
        (tmp_path / "none" / "bench.json", "cannot write"),
        (tmp_path, "is a folder"),
    ):
        result, _ = run(model_file(), "--json", path)
        assert result.exit_code == 1
        assert reason in result.output
        assert not cells_of(result.output)


PROGRAM = "from runtime.tools.commands import bench; bench()"


def wait_for_a_model(process):
    """Wait until a model's process has started: it, and Python's own helper."""
    path = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while len(children := path.read_text().split()) < 2:
        time.sleep(0.01)
    return [int(child) for child in children]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_ctrl_c_ends_all_processes(start_process, model_file):
    """As a terminal sends it, to the whole group, of which the command alone acts."""
    options = ["--size", "32x48", "--threads", 1, "--rounds"]
    command = [sys.executable, "-c", PROGRAM, model_file(), *options]
    process = start_process(*command, 2)
    for child in wait_for_a_model(process):
        os.kill(child, signal.SIGINT)
    stdout, stderr = process.communicate()
    assert (process.returncode, stderr) == (0, ""), stdout

    process = start_process(*command, 10**8)
    wait_for_a_model(process)
    os.killpg(process.pid, signal.SIGINT)
    stdout, stderr = process.communicate()
    assert (process.returncode, stderr) == (130, "")
    assert len(cells_of(stdout)) == 2
    for _ in range(100):  # the helper ends a moment later
        time.sleep(0.1)
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
    else:
        pytest.fail("a process is left")


@pytest.mark.slow
def test_each_model_has_a_process_and_one_that_ends_is_a_row(start_process, model_file, tmp_path):
    endless = {"x": [2**20, 2**20]}
    node = helper.make_node("Relu", ["x"], ["y"])
    huge = write_foreign(tmp_path / "huge.onnx", endless, [node])
    options = ["--size", "32x48", "--rounds", 2, "--threads", 1]
    command = [sys.executable, "-c", PROGRAM, "ssdnet-nano", model_file(), huge, *options]
    stdout, stderr = start_process(*command).communicate()
    _, nano, small, failed = cells_of(stdout)
    assert stderr == ""
    assert float(nano[8]) > float(small[8]) > 20, "each has its own peak of memory"
    assert failed[11].startswith("out of memory, choose a smaller size")
