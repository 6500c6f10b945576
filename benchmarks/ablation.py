"""Trains and scores recipes against one another, with several seeds each, as a table and a plot.

    python benchmarks/ablation.py --data DIR --runs RUNS [--seeds 0 1 2] [--rows ssdnet ...] \
        [--test KIND:FOLDER] [--set 'model.name = "ssdnet"'] [--markdown OUT.md] [--plot OUT.png]
    python benchmarks/ablation.py --table docs/results.md --plot OUT.png

A row is one of training/recipes/ablation.py, the name of another recipe of `ssdnet-train --list`,
or a TOML file. `DIR` holds their data; for the rows of the ablation these are the rendered scenes
`train` and `test`. Finished runs are not repeated, so more seeds or rows can be added, and a run
that was stopped resumes. A folder with runs of other settings is refused; it needs another `RUNS`.
Every row is scored on all frames of `--test` with the same LiDAR input, by default 5 % of the
depth. `--table` draws the first such table of a Markdown file without any run.

The run of docs/results.md:

    ssdnet-render DIR/train --scenes 300 --frames 4 --stride 20 --size 125x414 --seed 20000
    ssdnet-render DIR/test --scenes 60 --frames 4 --stride 20 --size 125x414 --seed 5000
    python benchmarks/ablation.py --data DIR --runs RUNS --threads 1 --seeds 0 1 2 --rows ssdnet \
        ssdnet-ind ssdnet-sem ssdnet-dep ssdnet-dep-d ssdnet-dep-rgb paper-class-weights \
        --set 'schedule.steps = 3750' --set 'data.augment.crop = [64, 224]' \
        --set 'model.config.sparse_depth_gain = 20.0' --set 'loss.weights.depth = 10.0' \
        --set 'loop.ema_decay = 0.998' --set 'data.cache_gib = 2.0' --plot ablation.png
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import mean, stdev
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import torch

from models import load_checkpoint
from models.checkpoint import RECIPE
from runtime.files.atomic_write import atomic_file, atomic_write
from training.chosen_recipe import read_stages
from training.datasets.any_source import parse_data
from training.evaluation.scoring import score, split_frames, torch_predict
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset
from training.recipes.ablation import ROWS
from training.run import TrainingRun
from training.run_folder import require_same
from training.stages import train_stages

mpl.use("Agg")
import matplotlib.pyplot as plt


class Column(NamedTuple):
    """A figure of the table: its title, the factor of its unit, and its digits."""

    title: str
    factor: float
    digits: int


COLUMNS = {
    "miou": Column("mIoU [%]", 100, 2),
    "boundary_f": Column("boundary F [%]", 100, 2),
    "mae_m": Column("MAE 0-100 m [mm]", 1000, 0),
    "rmse_m": Column("RMSE 0-100 m [mm]", 1000, 0),
}
# For each row and figure: mean and standard deviation (NaN of a single run) in the column's unit.
Summary = Mapping[str, Mapping[str, tuple[float, float]]]
# A value is drawn at the edge if its distance from the quartiles of the others is more than this
# many times the distance between the quartiles.
_OUTLIER = 3.0


def main(argv: Sequence[str] | None = None) -> None:
    """Train what is missing, seed by seed, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, nargs="+", default=[], help="folders of the data sets")
    parser.add_argument("--runs", type=Path, help="folder for the run folders")
    parser.add_argument("--rows", nargs="+", default=list(ROWS), help="[default: the ablation]")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--test", default="rendered:test", help="frames to score, as of --data of "
                        "ssdnet-eval, relative to --data")  # fmt: skip
    parser.add_argument("--lidar", default="random:0.05", help="the input, as of ssdnet-eval")
    parser.add_argument("--set", action="append", default=[], help="'table.key = value' in TOML")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2, help="of the processor")
    parser.add_argument("--markdown", type=Path, help="write the table here, too")
    parser.add_argument("--plot", type=Path, help="draw the rows here")
    parser.add_argument("--table", type=Path, help="draw the table of this file; trains nothing")
    arguments = parser.parse_args(argv)
    if arguments.table is not None:
        if arguments.plot is None:
            parser.error("--table needs --plot")
        draw(read_table(arguments.table.read_text()), arguments.plot)
        return
    if not arguments.data or arguments.runs is None:
        parser.error("give --data and --runs, or --table and --plot")
    torch.set_num_threads(arguments.threads)

    results: dict[str, list[dict[str, float]]] = {row: [] for row in arguments.rows}
    for seed in arguments.seeds:
        for row in arguments.rows:
            figures = run(row, seed, arguments)
            results[row].append(figures)
            shown = {key: round(figures[key], 4) for key in COLUMNS if key in figures}
            print(row, seed, shown, flush=True)
            # Written after each run, so that a program that is stopped leaves the table so far.
            if arguments.markdown:
                atomic_write(arguments.markdown, markdown(results).encode())
            if arguments.plot:
                draw(summary(results), arguments.plot)
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
    network = load_checkpoint(train_stages(stages, training).path).model.to(arguments.device)
    test = parse_data(arguments.test)
    source = open_dataset(test, arguments.data, classes=recipe.model.class_table)
    counted = score(
        torch_predict(network),
        split_frames(source, range(len(source)), LidarInput.parse(arguments.lidar)),
        num_classes=network.config.num_classes,
    )
    figures = counted.figures([info.name for info in network.config.classes])
    kept = {**figures, "test": arguments.test, "lidar": arguments.lidar}
    atomic_write(scores, json.dumps(kept, indent=2).encode())
    return figures


def summary(results: Mapping[str, Sequence[Mapping[str, float]]]) -> Summary:
    """Return mean and standard deviation of every row."""
    rows: dict[str, dict[str, tuple[float, float]]] = {}
    for row, runs in results.items():
        rows[row] = {}
        for key, column in COLUMNS.items():
            values = [column.factor * figures[key] for figures in runs if key in figures]
            if values:
                spread = stdev(values) if len(values) > 1 else float("nan")
                rows[row][key] = mean(values), spread
    return rows


def markdown(results: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Return mean and standard deviation of every row, as a Markdown table."""
    titles = [column.title for column in COLUMNS.values()]
    lines = ["| row | seeds | " + " | ".join(titles) + " |", "|---" * (len(COLUMNS) + 2) + "|"]
    for row, figures in summary(results).items():
        cells = []
        for key, column in COLUMNS.items():
            value, spread = figures.get(key, (float("nan"), float("nan")))
            text = "" if np.isnan(value) else f"{value:.{column.digits}f}"
            cells.append(text if np.isnan(spread) else f"{text} ± {spread:.{column.digits}f}")
        lines.append(f"| {row} | {len(results[row])} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def read_table(text: str) -> Summary:
    """Read the first table in a text that `markdown` wrote."""
    titles = {column.title: key for key, column in COLUMNS.items()}
    keys: list[str | None] = []
    rows: dict[str, dict[str, tuple[float, float]]] = {}
    for line in text.splitlines():
        cells = [cell.strip().strip("`") for cell in line.strip("| ").split("|")]
        if not keys and set(titles) <= set(cells):
            keys = [titles.get(cell) for cell in cells]
        elif keys and not line.startswith("|"):
            break
        elif keys and not line.startswith("|--"):
            rows[cells[0]] = {}
            for key, cell in zip(keys, cells, strict=False):
                if key and cell:
                    value, _, spread = cell.partition("±")
                    rows[cells[0]][key] = float(value), float(spread or "nan")
    return rows


def draw(rows: Summary, path: Path) -> None:
    """Draw the mean of every row and its standard deviation, with one panel for each figure.

    The axis spans the rows that are near one another. A row far from them is an arrow at the edge
    with its value.
    """
    figure, panels = plt.subplots(1, len(COLUMNS), figsize=(14, 0.42 * len(rows) + 1.4))
    for panel, (key, column) in zip(panels, COLUMNS.items(), strict=True):
        values = {row: found[key] for row, found in rows.items() if key in found}
        low, high = _limits([value for value, _ in values.values()])
        near = [pair for pair in values.values() if low <= pair[0] <= high]
        ends = [value + sign * np.nan_to_num(spread) for value, spread in near for sign in (-1, 1)]
        room = 0.08 * (max(ends, default=1) - min(ends, default=0)) or 1.0
        left, right = min(ends, default=0) - room, max(ends, default=1) + room
        for index, row in enumerate(rows):
            if row not in values:
                continue
            value, spread = values[row]
            if low <= value <= high:
                panel.errorbar(value, index, xerr=np.nan_to_num(spread), fmt="o", capsize=4,
                               color="tab:blue", ecolor="black")  # fmt: skip
                continue
            edge, side = (right, "right") if value > high else (left, "left")
            panel.annotate(f"   {value:.{column.digits}f}   ", (edge, index), color="tab:red",
                           ha=side, va="center")  # fmt: skip
            mark = ">" if side == "right" else "<"
            panel.plot([edge], [index], mark, color="tab:red", clip_on=False)
        panel.set_title(column.title)
        panel.set_xlim(left, right)
        panel.set_yticks(range(len(rows)), list(rows) if panel is panels[0] else [""] * len(rows))
        panel.set_ylim(len(rows) - 0.5, -0.5)
        panel.grid(axis="x", alpha=0.3)
    figure.tight_layout()
    with atomic_file(path) as file:
        figure.savefig(file, format="png", dpi=110)


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """Return the range outside of which a value is an outlier."""
    if not values:
        return 0.0, 1.0
    first, third = np.percentile(values, (25, 75))
    room = _OUTLIER * (third - first)
    return first - room, third + room


if __name__ == "__main__":
    main()
