"""Trains and scores recipes against one another, with several seeds each, as a table.

    python benchmarks/ablation.py --data DIR --runs RUNS [--seeds 0 1 2] [--rows ssdnet ...] \
        [--test KIND:FOLDER] [--set 'model.name = "ssdnet"']

A row is one of training/recipes/ablation.py, the name of another recipe of `ssdnet-train --list`,
or a TOML file. `DIR` holds their data; for the rows of the ablation these are the rendered scenes
`train` and `test`. Finished runs are not repeated, so more seeds or rows can be added, and a run
that was stopped resumes. A folder with runs of other settings is refused; it needs another `RUNS`.
Every row is scored on all frames of `--test` with the same LiDAR input, by default 5 % of the
depth.

The run of docs/results.md:

    ssdnet-render DIR/train --scenes 300 --frames 4 --stride 20 --size 125x414 --seed 20000
    ssdnet-render DIR/test --scenes 60 --frames 4 --stride 20 --size 125x414 --seed 5000
    python benchmarks/ablation.py --data DIR --runs RUNS --threads 1 --seeds 0 1 2 --rows ssdnet \
        ssdnet-ind ssdnet-sem ssdnet-dep ssdnet-dep-d ssdnet-dep-rgb paper-class-weights \
        --set 'schedule.steps = 3750' --set 'data.augment.crop = [64, 224]' \
        --set 'model.config.sparse_depth_gain = 20.0' --set 'loss.weights.depth = 10.0' \
        --set 'loop.ema_decay = 0.998' --set 'data.cache_gib = 2.0'
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from statistics import mean, stdev

import torch

from models.checkpoint import RECIPE
from runtime.files.atomic_write import atomic_write
from training.datasets.registry import parse_data
from training.evaluation.evaluate import evaluate
from training.recipes.ablation import ROWS
from training.recipes.chosen_recipe import read_stages
from training.run.run_folder import require_same
from training.run.stages import train_stages
from training.run.training_run import TrainingRun

# For each figure: title of its column, factor of its unit, and digits.
COLUMNS = {
    "miou": ("mIoU [%]", 100, 2),
    "boundary_f": ("boundary F [%]", 100, 2),
    "mae_m": ("MAE 0-100 m [mm]", 1000, 0),
    "rmse_m": ("RMSE 0-100 m [mm]", 1000, 0),
}


def main(argv: Sequence[str] | None = None) -> None:
    """Train what is missing, seed by seed, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="of the data sets")
    parser.add_argument("--runs", type=Path, required=True, help="folder for the run folders")
    parser.add_argument("--rows", nargs="+", default=list(ROWS), help="[default: the ablation]")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--test", default="rendered:test", help="frames to score, as of --data of "
                        "ssdnet-eval, relative to --data")  # fmt: skip
    parser.add_argument("--lidar", default="random:0.05", help="the input, as of ssdnet-eval")
    parser.add_argument("--set", action="append", default=[], help="'table.key = value' in TOML")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2, help="of the processor")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(arguments.threads)

    results: dict[str, list[dict[str, float]]] = {row: [] for row in arguments.rows}
    for seed in arguments.seeds:
        for row in arguments.rows:
            figures = run(row, seed, arguments)
            results[row].append(figures)
            shown = {key: round(figures[key], 4) for key in COLUMNS if key in figures}
            print(row, seed, shown, flush=True)
    print(f"\n{markdown(results)}")


def run(row: str, seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train one row with one seed, unless that was done before, and return its figures."""
    out = arguments.runs / f"{Path(row).stem}-{seed}"
    changes = [f"data.seed = {seed}", *arguments.set]
    stages = read_stages(f"ablation-{row}" if row in ROWS else row, changes)
    recipe = stages[-1].recipe
    scores = out / "scores.json"
    settings = {"recipe": asdict(recipe), "test": arguments.test, "lidar": arguments.lidar}
    if scores.is_file():
        known = json.loads(scores.read_text())
        place = out / stages[-1].folder / RECIPE
        trained = json.loads(place.read_text(encoding="utf-8"))
        before = {**settings, **{key: known.get(key, settings[key]) for key in ("test", "lidar")}}
        require_same({**before, "recipe": trained["recipe"]}, settings, place)  # no mix
        return {key: value for key, value in known.items() if key not in settings}
    training = TrainingRun(arguments.data, out, device=arguments.device)
    checkpoint = train_stages(stages, training).path
    test = parse_data(arguments.test)
    root = next(root for root in arguments.data if (root / test.path).exists())
    (scored,) = evaluate(
        [checkpoint],
        [replace(test, path=str(root / test.path))],
        lidars=[arguments.lidar],
        device=arguments.device,
        threads=arguments.threads,
        size="frame",
    ).rows
    figures = scored.figures
    kept = {**figures, "test": arguments.test, "lidar": arguments.lidar}
    atomic_write(scores, json.dumps(kept, indent=2).encode())
    return figures


def markdown(results: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Return mean and standard deviation of every row, as a Markdown table."""
    titles = [title for title, *_ in COLUMNS.values()]
    lines = ["| row | seeds | " + " | ".join(titles) + " |", "|---" * (len(COLUMNS) + 2) + "|"]
    for row, runs in results.items():
        cells = []
        for key, (_, factor, digits) in COLUMNS.items():
            values = [factor * figures[key] for figures in runs if key in figures]
            cell = f"{mean(values):.{digits}f}" if values else ""
            cells.append(f"{cell} ± {stdev(values):.{digits}f}" if len(values) > 1 else cell)
        lines.append(f"| {row} | {len(runs)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
