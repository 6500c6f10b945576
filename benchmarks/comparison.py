"""Our networks beside other people's and classical methods: trained alike, scored, timed.

    python benchmarks/comparison.py train --data DIR --runs RUNS [--ablation DIR]
    python benchmarks/comparison.py time --runs RUNS [--rounds 10] [--sizes 125x414 512x1024]
    python benchmarks/comparison.py table --runs RUNS [--markdown OUT.md]

`train` is a queue: it trains, exports and scores what comparison.toml lists, one after the other,
each to the budget of its recipe, and then the rows of the ablation, if it is told where their
scenes are. The same command goes on where it was stopped; what is done with the same settings is
not done again. `time` runs all in turn in one process, on a quiet machine; networks that are not
trained yet, or are not at all, run with random weights. `table` shows what there is, a table a
task.

More time: --set 'schedule.steps = 20000', which needs a RUNS of its own. Some alone: --only NAME.
A candidate of the file (see plan.py) may say, too:

    recipe = "comparison-depth"  # in place of the common one
    network = "fcn8s"            # not trained, but timed
    method = "ip-basic"          # a classical method of depth completion
    published_miou = 57.0        # on CamVid test, in percent, shown beside
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pydantic.dataclasses import dataclass

import ablation
from export.deploy import DeployGraph
from models import create_model
from models.registry import NETWORKS
from plan import (
    ONNX,
    SCORES,
    Candidate,
    Plan,
    Sets,
    find_or_make,
    find_or_score,
    read_candidate,
    read_plan,
)
from runtime import Predictor
from runtime.bundled_models import find_model
from runtime.command import INTERRUPTED
from runtime.errors import InputError, SSDNetError
from runtime.io.atomic_write import atomic_write
from runtime.model_file import load_model_file
from speed import TRACED_AT, compare, parse_size
from timing import Model, Size, describe, export_graph
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.classical import create_method
from training.limits import STRICT
from training.network import build_network
from training.run_folder import RECIPE
from training.stop_signal import StopSignal

TIMES = "times.json"
SIZES: list[Size] = [(125, 414), (512, 1024)]
#: Head -> the sets that it is scored on, below --data.
SETS: Mapping[str, Sets] = {
    "semantic": {"camvid": (CamVidRecipe(path="camvid", split="val"), ["none"])},
    "depth": {
        "streets": (KittiStreetsRecipe(path="kitti_streets", first=70), ["64", "16"]),
        "stream": (KittiStreamRecipe(path="kitti_stream", first=50, last=59), ["own"]),
        "rendered": (RenderedRecipe(path="rendered/val"), ["64"]),
    },
}
#: Where a column's figures stand among the scores, and its title.
DEPTH_COLUMNS = {
    "streets 64": "KITTI streets, 64 lines",
    "streets 16": "16 lines",
    "stream own": "KITTI frames 50-59, 32 lines",
    "rendered 64": "rendered, 64 lines",
}


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Entry(Candidate):
    """A candidate, a network that is only timed, or a classical method."""

    network: str | None = None
    method: str | None = None
    published_miou: float | None = None

    @property
    def is_trained(self) -> bool:
        """Whether it needs a recipe."""
        return not (self.onnx or self.network or self.method)


#: What each entry answers, in the order of the file.
Heads = Mapping[Entry, Sequence[str]]


def main(argv: Sequence[str] | None = None) -> None:
    """Do what the command line asks for."""
    arguments = parse_arguments(argv)
    torch.set_num_threads(arguments.threads)
    try:
        plan = read_plan(arguments.plan, arguments.set, arguments.only, kind=Entry)
        # All can be built, before the first is trained.
        heads = {item: heads_of(item, plan) for item in plan.candidates if isinstance(item, Entry)}
        arguments.run(plan, heads, arguments)
    except SSDNetError as error:
        raise SystemExit(f"error: {error}") from error


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--plan", type=Path, default=Path(__file__).with_suffix(".toml"))
    common.add_argument("--runs", type=Path, required=True, help="folder for the run folders")
    common.add_argument("--set", action="append", default=[], help="'table.key = value', for all")
    common.add_argument("--only", nargs="+", help="names of candidates")
    common.add_argument("--threads", type=int, default=2, help="of the processor")

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    verb = verbs.add_parser("train", parents=[common], help="train and score what is missing")
    verb.add_argument("--data", type=Path, action="append", required=True)
    verb.add_argument("--limit", type=int, help="frames scored of each set, evenly spread")
    verb.add_argument("--device", default="cpu")
    verb.add_argument("--ablation", type=Path, help="its scenes, see ablation.py --data")
    verb.set_defaults(run=train_all)
    verb = verbs.add_parser("time", parents=[common], help="time all in turn")
    verb.add_argument("--sizes", nargs="+", default=SIZES, type=parse_size, help="HEIGHTxWIDTH")
    verb.add_argument("--rounds", type=int, default=10)
    verb.set_defaults(run=time_all)
    verb = verbs.add_parser("table", parents=[common], help="show what there is")
    verb.add_argument("--markdown", type=Path, help="write the tables here, too")
    verb.set_defaults(run=show)
    return parser.parse_args(argv)


def heads_of(entry: Entry, plan: Plan) -> tuple[str, ...]:
    """Return what an entry answers. Raises InputError for what cannot be built."""
    if entry.method is not None:
        create_method(entry.method)
        return ("depth",)
    if entry.network is not None:
        if entry.network not in NETWORKS:
            raise InputError(f"no network {entry.network!r}; known: {', '.join(NETWORKS)}.")
        with torch.device("meta"):
            return create_model(entry.network).heads
    if entry.onnx is not None:
        with Predictor(find_model(entry.onnx)) as predictor:
            return predictor.heads
    return build_network(read_candidate(entry, plan).model, None).heads


def train_all(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Train, export and score what is missing. Raises SystemExit if stopped or if any failed."""
    failed = []
    with StopSignal() as stop:
        for entry, answers in heads.items():
            try:
                if not finish(entry, plan, answers, arguments, stop):
                    raise SystemExit(INTERRUPTED)
            except SSDNetError as error:
                print(f"{entry.name}: left out: {error}", flush=True)
                failed.append(entry.name)
    if arguments.ablation is not None:
        runs, threads = arguments.runs / "ablation", arguments.threads
        parts = ["--data", arguments.ablation, "--runs", runs, "--threads", threads]
        ablation.main([str(part) for part in [*parts, "--device", arguments.device]])
    if failed:
        raise SystemExit(f"error: {len(failed)} left out: {', '.join(failed)}")


def finish(
    entry: Entry,
    plan: Plan,
    heads: Sequence[str],
    arguments: argparse.Namespace,
    stop: StopSignal,
) -> bool:
    """Train, export and score an entry, and say what it scored; False if stopped."""
    if entry.network is not None:
        return True
    out = arguments.runs / entry.folder
    sets = find_sets(heads, arguments.data)
    if entry.method is not None:
        scores = find_or_score(out, sets, arguments, onnx=None, method=entry.method)
    else:
        onnx = find_or_make(entry, plan, arguments, stop)
        if onnx is None:
            return False
        scores = find_or_score(out, sets, arguments, onnx=onnx)
    shown = {
        f"{place} {key}": round(values[key], 4)
        for place, values in scores.items()
        for key in ("miou", "mae_m", "rmse_m")
        if key in values
    }
    print(entry.name, shown, flush=True)
    return not stop()


def find_sets(heads: Sequence[str], roots: Sequence[Path]) -> Sets:
    """Return the sets of these heads that are below the folders. Raises InputError if none is."""
    found = {}
    wanted = {name: item for head in heads for name, item in SETS.get(head, {}).items()}
    for name, (recipe, lidars) in wanted.items():
        for root in roots:
            if (root / recipe.path).is_dir():
                # As `evaluate` takes it: a path that stands by itself.
                found[name] = (replace(recipe, path=str(root / recipe.path)), lidars)
                break
    if not found:
        paths = ", ".join(recipe.path for recipe, _ in wanted.values())
        raise InputError(
            f"below {', '.join(map(str, roots))} is none of {paths}: nothing to score on. Give "
            "--data that has one."
        )
    return found


def time_all(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Time all entries in one interleaved run and keep the figures with the runs."""
    models = {entry.name: open_entry(entry, plan, arguments.runs) for entry in heads}
    reference = next(iter(models))
    document = compare(models, reference, arguments.sizes, arguments.threads, arguments.rounds)
    arguments.runs.mkdir(parents=True, exist_ok=True)
    atomic_write(arguments.runs / TIMES, json.dumps(document, indent=2).encode())
    print(to_tables(heads, arguments.runs))


def open_entry(entry: Entry, plan: Plan, runs: Path) -> Model:
    """Return what is timed: the exported file, random weights in its place, or a method."""
    if entry.method is not None:
        return create_method(entry.method)
    path = find_model(entry.onnx) if entry.onnx is not None else runs / entry.folder / ONNX
    if entry.network is not None:
        network = create_model(entry.network)
    elif path.is_file():
        return load_model_file(path).content
    else:
        network = build_network(read_candidate(entry, plan).model, None)
    return export_graph(DeployGraph(network.eval()), TRACED_AT, dynamic=True)


def show(plan: Plan, heads: Heads, arguments: argparse.Namespace) -> None:
    """Print the tables of what there is, and write them."""
    text = to_tables(heads, arguments.runs)
    print(text)
    if arguments.markdown:
        atomic_write(arguments.markdown, text.encode())


def to_tables(heads: Heads, runs: Path) -> str:
    """A table a task; a figure that is not there is an empty cell."""
    times = read_json(runs / TIMES)
    parts = []
    for head, title in (("semantic", "Semantics"), ("depth", "Depth completion, MAE / RMSE in mm")):
        columns = ["CamVid val mIoU %", "published, test"]
        if head == "depth":
            columns = list(DEPTH_COLUMNS.values())
        columns = ["network", "trained", *columns, "params M", "GMACs"]
        columns += [f"ms, {_name(part['size'])}" for part in times.get("sizes", [])]
        lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
        for entry, answers in heads.items():
            if head in answers:
                lines.append(f"| {' | '.join(_row(entry, head, runs, times))} |")
        parts.append(f"**{title}**\n\n" + "\n".join(lines))
    if times:
        parts.append(f"GMACs at {_name(times['sizes'][0]['size'])}. {describe(times['machine'])}.")
    return "\n\n".join(parts) + "\n"


def _row(entry: Entry, head: str, runs: Path, times: Mapping[str, Any]) -> list[str]:
    scores = read_json(runs / entry.folder / SCORES).get("figures", {})
    cells = [entry.name, _describe_training(entry, runs)]
    if head == "semantic":
        miou, published = scores.get("camvid none", {}).get("miou"), entry.published_miou
        cells += ["" if miou is None else f"{100 * miou:.1f}"]
        cells += ["" if published is None else f"{published:g}"]
    else:
        for place in DEPTH_COLUMNS:
            errors = [scores.get(place, {}).get(key) for key in ("mae_m", "rmse_m")]
            cells.append("" if None in errors else " / ".join(f"{1e3 * m:.0f}" for m in errors))
    timed: list[dict[str, Any]] = [
        next((row for row in part["rows"] if row["network"] == entry.name), {})
        for part in times.get("sizes", [])
    ]
    counted = timed[0] if timed and entry.method is None else {}
    cells += [f"{counted[key]:.3g}" if key in counted else "" for key in ("params_m", "gmacs")]
    return [*cells, *(_round(row["median_ms"]) if row else "" for row in timed)]


def _describe_training(entry: Entry, runs: Path) -> str:
    if entry.method is not None:
        return "no training"
    if entry.onnx is not None:
        return "as it ships"
    if entry.network is not None:
        return "not trained here"
    if not (runs / entry.folder / ONNX).is_file():
        return "not yet"
    recipe = read_json(runs / entry.folder / RECIPE)["recipe"]
    samples = (
        recipe["schedule"]["steps"] * recipe["data"]["batch_size"] * recipe["loop"]["accumulate"]
    )
    return f"{samples} samples"


def _round(ms: float) -> str:
    return f"{ms:.1f}" if ms < 100 else f"{ms:.0f}"


def _name(size: Sequence[int]) -> str:
    return f"{size[0]} x {size[1]}"


def read_json(path: Path) -> dict[str, Any]:
    """Return a document, {} if it is not there."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


if __name__ == "__main__":
    main()
