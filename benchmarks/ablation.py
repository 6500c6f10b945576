"""Train and score the rows of the paper's ablation, several seeds each, as a table and a plot.

    python benchmarks/ablation.py --data DIR --runs RUNS [--seeds 0 1 2] [--rows ssdnet ...] \
        [--set 'model.name = "ssdnet"'] [--markdown OUT.md] [--plot OUT.png]

`DIR` holds the rendered scenes `train` and `test`. Rows are those of training/recipes/ablation.py.
Runs that are finished are not repeated, so more seeds or rows can be added; one that was stopped
resumes. Runs of other settings are refused: give another `RUNS`. Every row is scored on all of
`test` with 5 % of the depth, drawn once for all rows.

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

import matplotlib as mpl
import torch

from models import load_checkpoint
from runtime.files.atomic_write import atomic_file, atomic_write
from training.chosen_recipe import read_stages
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.scoring import score, split_frames, torch_predict
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset
from training.loop import train
from training.recipes.ablation import ROWS
from training.run_folder import RECIPE, require_same

mpl.use("Agg")
import matplotlib.pyplot as plt

FIGURES = {
    "miou": "mIoU [%]",
    "boundary_f": "boundary F [%]",
    "mae_m": "MAE 0-100 m [cm]",
    "rmse_m": "RMSE 0-100 m [cm]",
}
_INPUT = LidarInput("random", share=0.05)


def main(argv: Sequence[str] | None = None) -> None:
    """Train what is missing, seed by seed, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--runs", type=Path, required=True, help="folder for the run folders")
    parser.add_argument("--rows", nargs="+", default=list(ROWS), help="[default: all]")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--set", action="append", default=[], help="'table.key = value' in TOML")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2, help="of the processor")
    parser.add_argument("--markdown", type=Path, help="write the table here, too")
    parser.add_argument("--plot", type=Path, help="draw the rows here")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(arguments.threads)

    results: dict[str, list[dict[str, float]]] = {row: [] for row in arguments.rows}
    for seed in arguments.seeds:
        for row in arguments.rows:
            figures = run(row, seed, arguments)
            results[row].append(figures)
            shown = {key: round(figures[key], 4) for key in FIGURES if key in figures}
            print(row, seed, shown, flush=True)
            # After each run, so that a stopped program leaves the table so far.
            if arguments.markdown:
                atomic_write(arguments.markdown, markdown(results).encode())
            if arguments.plot:
                draw(results, arguments.plot)
    print(f"\n{markdown(results)}")


def run(row: str, seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train one row with one seed, unless that is done, and return its figures."""
    out = arguments.runs / f"{row}-{seed}"
    changes = [f"data.seed = {seed}", *arguments.set]
    recipe = read_stages(f"ablation-{row}", changes)[0].recipe
    scores = out / "scores.json"
    if scores.is_file():
        known = json.loads((out / RECIPE).read_text(encoding="utf-8"))
        require_same(known, {"recipe": asdict(recipe)}, out / RECIPE)  # no mixed settings
        return json.loads(scores.read_text())
    checkpoint = train(recipe, data=[arguments.data], out=out, device=arguments.device)
    network = load_checkpoint(checkpoint).model.to(arguments.device)
    source = open_dataset(RenderedRecipe(path="test"), [arguments.data], classes="camvid")
    counted = score(
        torch_predict(network),
        split_frames(source, range(len(source)), _INPUT),
        num_classes=network.config.num_classes,
    )
    figures = counted.figures([info.name for info in network.config.classes])
    atomic_write(scores, json.dumps(figures, indent=2).encode())
    return figures


def markdown(results: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Mean and standard deviation of every row, as a table."""
    lines = [
        "| row | seeds | " + " | ".join(FIGURES.values()) + " |",
        "|---" * (len(FIGURES) + 2) + "|",
    ]
    for row, runs in results.items():
        cells = []
        for key in FIGURES:
            values = [figures[key] * 100 for figures in runs if key in figures]
            spread = f" ± {stdev(values):.2f}" if len(values) > 1 else ""
            cells.append(f"{mean(values):.2f}{spread}" if values else "")
        lines.append(f"| {row} | {len(runs)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def draw(results: Mapping[str, Sequence[Mapping[str, float]]], path: Path) -> None:
    """Every run as a point and the mean as a bar, a panel a figure."""
    figure, panels = plt.subplots(1, len(FIGURES), figsize=(14, 0.42 * len(results) + 1.4))
    rows = list(results)
    for panel, key in zip(panels, FIGURES, strict=True):
        for index, row in enumerate(rows):
            values = [run[key] * 100 for run in results[row] if key in run]
            if values:
                panel.plot(values, [index] * len(values), "o", color="tab:blue", alpha=0.6)
                panel.plot([mean(values)] * 2, [index - 0.3, index + 0.3], color="black")
        panel.set_title(FIGURES[key])
        panel.set_yticks(range(len(rows)), rows if panel is panels[0] else [""] * len(rows))
        panel.set_ylim(len(rows) - 0.5, -0.5)
        panel.grid(axis="x", alpha=0.3)
    figure.tight_layout()
    with atomic_file(path) as file:
        figure.savefig(file, format="png", dpi=110)


if __name__ == "__main__":
    main()
