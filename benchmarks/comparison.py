"""Trains, scores and times our networks beside those of others and classical methods.

    python benchmarks/comparison.py train --data DIR --runs RUNS
    python benchmarks/comparison.py time --runs RUNS [--rounds 10] [--sizes 125x414 512x1024]
    python benchmarks/comparison.py table --runs RUNS

`train` trains, exports and scores the entries of comparison.toml one after the other, each with the
budget of its recipe. The same command resumes where it was stopped, and keeps what is finished with
the same settings. `time` measures all entries like ssdnet-bench, on a quiet machine; networks
without a trained model run with random weights. `table` prints a table for each task.

For longer trainings use --set 'schedule.steps = 20000' with another RUNS. For single entries use
--only NAME.
"""

import argparse
import hashlib
import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from comparison_entries import (
    ONNX,
    SCORES,
    TIMES,
    Entry,
    Heads,
    Plan,
    heads_of,
    network_of,
    read_json,
    read_plan,
    recipe_of,
)
from comparison_tables import to_tables
from export.deploy import DeployGraph
from export.exporter import count_giga_macs, export_checkpoint
from models.checkpoint import FINAL, RECIPE
from random_weights import TRACED_AT, count_params_m, export_graph
from runtime.app.tools.bench import BenchOptions, bench
from runtime.app.tools.bench_worker import time_runs
from runtime.base.errors import InputError, SSDNetError
from runtime.command.process import INTERRUPTED
from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import find_model
from runtime.engine.example_inputs import make_input
from runtime.files.atomic_write import atomic_write
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.source_recipe import SourceRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.classical import create_method
from training.evaluation.evaluate import evaluate
from training.loop import train
from training.run import TrainingRun
from training.run_folder import require_same
from training.stop_signal import stop_signal

Size = tuple[int, int]  # (height, width)
Stop = Callable[[], bool]  # whether a signal arrived
SIZES: list[Size] = [(125, 414), (512, 1024)]

# Recipe of each set, whose path is below --data, and the LiDARs with which it is scored.
Sets = Mapping[str, tuple[SourceRecipe, Sequence[str]]]
# The sets on which each head is scored.
SETS: Mapping[str, Sets] = {
    "semantic": {"camvid": (CamVidRecipe(path="camvid", split="val"), ["none"])},
    "depth": {
        "streets": (KittiStreetsRecipe(path="kitti_streets", first=70), ["64", "16"]),
        "stream": (KittiStreamRecipe(path="kitti_stream", first=50, last=59), ["own"]),
        "rendered": (RenderedRecipe(path="rendered/val"), ["64"]),
    },
}


def main(argv: Sequence[str] | None = None) -> None:
    """Run one of the three verbs."""
    arguments = parse_arguments(argv)
    torch.set_num_threads(arguments.threads)
    try:
        plan = read_plan(arguments.plan, arguments.set, arguments.only)
        # Checks that all can be built before the first is trained.
        heads = {entry: heads_of(entry, plan) for entry in plan.entries}
        arguments.run(plan, heads, arguments)
    except SSDNetError as error:
        raise SystemExit(f"error: {error}") from error


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--plan",
        type=Path,
        default=Path(__file__).with_suffix(".toml"),
        help="entries and their recipes [default: comparison.toml beside this file]",
    )
    common.add_argument("--runs", type=Path, required=True, help="folder for the run folders")
    common.add_argument("--set", action="append", default=[], help="'table.key = value', for all")
    common.add_argument("--only", nargs="+", help="names of entries")
    common.add_argument("--threads", type=int, default=2, help="of the processor")

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("train", parents=[common], help="train and score what is missing")
    verb.add_argument(
        "--data",
        type=Path,
        action="append",
        required=True,
        metavar="DIR",
        help="folder of the data sets; may be repeated, the first that has a set is taken",
    )
    verb.add_argument("--limit", type=int, help="frames scored of each set, evenly spread")
    verb.add_argument(
        "--device", default="cpu", help="trains there, e.g. cuda [default: %(default)s]"
    )
    verb.set_defaults(run=train_all)
    verb = verbs.add_parser("time", parents=[common], help="time all entries, interleaved")
    verb.add_argument("--sizes", nargs="+", default=SIZES, type=_size, help="HEIGHTxWIDTH")
    verb.add_argument("--rounds", type=int, default=10)
    verb.set_defaults(run=time_all)
    verb = verbs.add_parser("table", parents=[common], help="print the tables")
    verb.set_defaults(run=print_tables)
    return parser.parse_args(argv)


def _size(text: str) -> Size:
    height, width = map(int, text.split("x"))
    return height, width


def train_all(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Train, export and score what is missing. Raises SystemExit if stopped or if any failed."""
    failed = []
    with stop_signal() as stop:
        for entry, answers in heads.items():
            try:
                finish(entry, plan, answers, arguments, stop)
            except SSDNetError as error:
                print(f"{entry.name}: left out: {error}", flush=True)
                failed.append(entry.name)
            if stop():
                print("stopped; the same command resumes")
                raise SystemExit(INTERRUPTED)
    if failed:
        raise SystemExit(f"error: {len(failed)} left out: {', '.join(failed)}")


def finish(
    entry: Entry,
    plan: Plan,
    heads: Sequence[str],
    arguments: argparse.Namespace,
    stop: Stop,
) -> None:
    """Train, export and score an entry and print its scores, unless stopped."""
    if entry.network is not None:
        return
    sets = find_sets(heads, arguments.data)
    onnx = None
    if entry.onnx is not None:
        onnx = find_model(entry.onnx)
    elif entry.method is None:
        onnx = find_or_make(entry, plan, arguments, stop)
        if stop():
            return
    scores = find_or_score(arguments.runs / entry.folder, sets, arguments, onnx, entry.method)
    shown = {
        f"{place} {key}": round(values[key], 4)
        for place, values in scores.items()
        for key in ("miou", "mae_m", "rmse_m")
        if key in values
    }
    print(entry.name, shown, flush=True)


def find_sets(heads: Sequence[str], roots: Sequence[Path]) -> Sets:
    """Return the sets for these heads that the folders hold. Raises InputError without one."""
    wanted = {name: item for head in heads for name, item in SETS.get(head, {}).items()}
    found = {}
    for name, (recipe, lidars) in wanted.items():
        folder = next((root / recipe.path for root in roots if (root / recipe.path).is_dir()), None)
        if folder is not None:
            found[name] = (replace(recipe, path=str(folder)), lidars)
    if not found:
        paths = ", ".join(recipe.path for recipe, _ in wanted.values())
        raise InputError(
            f"below {', '.join(map(str, roots))} is none of {paths}: nothing to score on: give "
            "--data that has one"
        )
    return found


def find_or_make(entry: Entry, plan: Plan, arguments: argparse.Namespace, stop: Stop) -> Path:
    """Return an entry's ONNX file; train and export it if it is missing, unless stopped."""
    recipe = recipe_of(entry, plan)
    out = arguments.runs / entry.folder
    onnx, checkpoint = out / ONNX, out / FINAL
    if checkpoint.is_file():
        require_same(read_json(out / RECIPE), {"recipe": asdict(recipe)}, out / RECIPE)
    else:
        train(recipe, TrainingRun(arguments.data, out, device=arguments.device, stop=stop))
        if stop():
            return onnx
    digest = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    if not onnx.is_file() or load_model_file(onnx).contract.checkpoint_sha256 != digest:
        export_checkpoint(checkpoint, onnx, size=TRACED_AT, dynamic=True, overwrite=True)
    return onnx


def find_or_score(
    out: Path, sets: Sets, arguments: argparse.Namespace, onnx: Path | None, method: str | None
) -> dict[str, dict[str, float]]:
    """Return the figures for each "set lidar" of a file or a classical method; kept in `out`."""
    settings = {
        "scored": method if onnx is None else load_model_file(onnx).sha256,
        "sets": {name: [asdict(recipe), list(lidars)] for name, (recipe, lidars) in sets.items()},
        "limit": arguments.limit,
    }
    settings = json.loads(json.dumps(settings))  # in the form in which they are read back
    known = read_json(out / SCORES)
    if known.get("settings") == settings:
        return dict(known["figures"])
    result = {}
    for name, (recipe, lidars) in sets.items():
        rows = evaluate(
            [method or str(onnx)],
            [recipe],
            lidars=lidars,
            threads=arguments.threads,
            limit=arguments.limit,
        ).rows
        result |= {f"{name} {row.lidar}": row.figures for row in rows}
    out.mkdir(parents=True, exist_ok=True)
    document = {"settings": settings, "figures": result}
    atomic_write(out / SCORES, json.dumps(document, indent=2).encode())
    return result


def time_all(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Time all entries and store the figures beside the runs. Raises InputError if one fails."""
    networks = [entry for entry in heads if entry.method is None]
    sizes, threads, rounds = arguments.sizes, arguments.threads, arguments.rounds
    with TemporaryDirectory() as folder:
        files = [find_file(entry, plan, arguments.runs, Path(folder)) for entry in networks]
        report = bench(BenchOptions(tuple(files), tuple(sizes), (threads,), rounds=rounds))
    if report.interrupted:
        raise SystemExit(INTERRUPTED)
    document: dict[str, Any] = {
        "machine": f"{report.machine.processor}, {threads} threads, load {report.load:.2f} at the "
        f"start, onnxruntime {report.onnxruntime}, {rounds} rounds in turn",
        "sizes": [],
    }
    for size, group in zip(sizes, report.groups, strict=True):
        rows: dict[str, dict[str, float | None]] = {
            entry.name: {"median_ms": time_method(entry.method, size, rounds)}
            for entry in heads
            if entry.method is not None
        }
        for entry, row in zip(networks, group, strict=True):
            if row.opened is None or row.latency is None:
                raise InputError(f"{entry.name}: {row.error}")
            network = network_of(entry, plan)
            rows[entry.name] = {
                "params_m": count_params_m(network),
                "gmacs": count_giga_macs(network, size),
                "median_ms": row.latency.median_ms,
            }
        document["sizes"].append({"size": size, "rows": rows})
    arguments.runs.mkdir(parents=True, exist_ok=True)
    atomic_write(arguments.runs / TIMES, json.dumps(document, indent=2).encode())
    print(to_tables(heads, arguments.runs))


def find_file(entry: Entry, plan: Plan, runs: Path, folder: Path) -> str:
    """Return a bundled name or a file to time; random weights are written to `folder`."""
    path = runs / entry.folder / ONNX
    if entry.onnx is not None:
        return entry.onnx
    if entry.network is None and path.is_file():
        return str(path)
    path = folder / f"{entry.folder}.onnx"
    path.write_bytes(export_graph(DeployGraph(network_of(entry, plan).eval())))
    return str(path)


def time_method(name: str, size: Size, rounds: int) -> float:
    """Return the median time [ms] of a classical method, which runs on one thread."""
    method = create_method(name)
    rgb = make_input("rgb", "tensor(uint8)", (*size, 3))
    sparse_depth = make_input("sparse_depth", "tensor(float)", size)
    times_ms = time_runs(lambda: method.complete(rgb, sparse_depth), rounds + 1)[1:]
    return statistics.median(times_ms)


def print_tables(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Print the tables."""
    print(to_tables(heads, arguments.runs))


if __name__ == "__main__":
    main()
