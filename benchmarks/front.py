"""Accuracy against milliseconds: candidates of the architecture trained alike, and the front.

    python benchmarks/front.py benchmarks/front.toml --data DIR --runs RUNS \
        [--set 'schedule.steps = 500'] [--only NAME ...] [--onnx NAME|PATH ...] [--peers NAME ...] \
        [--size 512x1024] [--markdown OUT.md] [--plot OUT.png] [--json OUT.json]

The file names a recipe, changes of it for all (`set`) and the candidates:

    recipe = "lite"
    set = ["schedule.steps = 1500"]
    [[candidate]]
    name = "fewer blocks"
    set = ["model.config.encoder_blocks = [1, 1, 1, 1]"]   # fields of the network's configuration
    init = "ssdnet-lite"                                   # weights to start from, if any
    [[candidate]]
    name = "as it ships"
    onnx = "ssdnet-lite"                                   # a bundled model or a file: not trained

Each is trained, exported and scored through the exported file on CamVid val (mIoU) and the
validation block of kitti_streets (MAE and RMSE, 64 and 16 lines), as far as these are below --data;
then all are timed in one interleaved run, together with --peers, which are networks of random
weights. The same command goes on where it was stopped: what is trained or scored with the same
settings is not done again; times are always of one run. A candidate that fails is left out, and
said at the end.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch

from plan import Candidate, Plan, Sets, find_or_make, find_or_score, read_plan
from runtime.command import INTERRUPTED
from runtime.errors import InputError, SSDNetError
from runtime.io.atomic_write import atomic_file, atomic_write
from speed import load_network, parse_size
from timing import Model, Size, describe, figures, machine, measure, open_timed
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.source import SourceRecipe
from training.stop_signal import StopSignal

mpl.use("Agg")
import matplotlib.pyplot as plt

STREETS_FIRST, STREETS_LAST = 83, 98
LIDARS = ("64", "16")

#: Figure -> its title, factor, and whether more is better.
FIGURES = {
    "miou": ("mIoU %", 100.0, True),
    "mae_64": ("MAE mm, 64 lines", 1000.0, False),
    "rmse_64": ("RMSE mm", 1000.0, False),
    "mae_16": ("MAE mm, 16 lines", 1000.0, False),
    "rmse_16": ("RMSE mm", 1000.0, False),
    "road_iou": ("road IoU %", 100.0, True),
}
PLOTTED = ("miou", "mae_64", "mae_16")


def main() -> None:
    """Do what is missing, then time, print and draw."""
    arguments = parse_arguments()
    torch.set_num_threads(arguments.threads)
    try:
        plan = read_plan(arguments.plan, arguments.set, arguments.only, onnx=arguments.onnx)
        peers = {name: load_network(name) for name in arguments.peers}
        with StopSignal() as stop:
            done, failed = prepare_all(plan, arguments, stop)
        if stop():
            raise SystemExit(INTERRUPTED)
        if not done:
            raise InputError("no candidate could be trained and scored.")
    except SSDNetError as error:
        raise SystemExit(f"error: {error}") from error
    document = time_all(done, peers, arguments)
    text = to_table(document)
    print(f"\n{text}")
    if arguments.markdown:
        atomic_write(arguments.markdown, text.encode())
    if arguments.json:
        atomic_write(arguments.json, json.dumps(document, indent=2).encode())
    if arguments.plot:
        draw(document, arguments.plot)
    if failed:
        raise SystemExit(f"error: {len(failed)} left out: {', '.join(failed)}")


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plan", type=Path, help="file of the candidates (TOML)")
    parser.add_argument("--data", type=Path, action="append", required=True)
    parser.add_argument("--runs", type=Path, required=True, help="folder for the run folders")
    parser.add_argument("--set", action="append", default=[], help="'table.key = value', for all")
    parser.add_argument("--only", nargs="+", help="names of candidates")
    parser.add_argument("--onnx", nargs="+", default=[], help="score and time these, too")
    parser.add_argument("--peers", nargs="+", default=[], help="time these, see speed.py")
    parser.add_argument("--size", type=parse_size, default=(512, 1024), help="of the timing")
    parser.add_argument("--rounds", type=int, default=30, help="of the timing")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--limit", type=int, help="frames scored of each set, evenly spread")
    parser.add_argument("--device", default="cpu", help="of the training")
    parser.add_argument("--markdown", type=Path, help="write the table here, too")
    parser.add_argument("--plot", type=Path, help="draw the front here (PNG)")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    return parser.parse_args()


def prepare_all(
    plan: Plan, arguments: argparse.Namespace, stop: StopSignal
) -> tuple[dict[str, tuple[bytes, dict[str, float]]], list[str]]:
    """Train, export and score: name -> file and figures, and the names of those that failed."""
    done, failed = {}, []
    for candidate in plan.candidates:
        try:
            path = find_or_make(candidate, plan, arguments, stop)
            if path is None:
                break
            figures_of = score(candidate, path, arguments)
            done[candidate.name] = (path.read_bytes(), figures_of)
            shown = {key: round(value, 4) for key, value in figures_of.items()}
            print(candidate.name, shown, flush=True)
        except SSDNetError as error:
            print(f"{candidate.name}: left out: {error}", flush=True)
            failed.append(candidate.name)
    return done, failed


def score(candidate: Candidate, onnx: Path, arguments: argparse.Namespace) -> dict[str, float]:
    """Return a file's figures, as far as the sets are there; kept beside its run."""
    sets = find_sets(arguments.data)
    out = arguments.runs / candidate.folder
    result: dict[str, float] = {}
    for place, values in find_or_score(out, sets, arguments, onnx=onnx).items():
        lidar = place.rpartition(" ")[2]
        result |= {key: values[key] for key in ("miou", "road_iou") if key in values}
        if "mae_m" in values:
            result |= {f"mae_{lidar}": values["mae_m"], f"rmse_{lidar}": values["rmse_m"]}
    return result


def find_sets(roots: Sequence[Path]) -> Sets:
    """Return the sets that are below the folders, each with its LiDARs. Raises InputError."""
    sets: dict[str, tuple[SourceRecipe, Sequence[str]]] = {}
    for root in roots:
        if (root / "camvid").is_dir():
            sets["camvid"] = (CamVidRecipe(path=str(root / "camvid"), split="val"), ("none",))
        if (root / "kitti_streets").is_dir():
            streets = KittiStreetsRecipe(
                path=str(root / "kitti_streets"), first=STREETS_FIRST, last=STREETS_LAST
            )
            sets["streets"] = (streets, LIDARS)
    if not sets:
        raise InputError(
            f"below {', '.join(map(str, roots))} is neither camvid nor kitti_streets: nothing to "
            "score on. Give --data that has one."
        )
    return sets


def time_all(
    done: dict[str, tuple[bytes, dict[str, float]]],
    peers: dict[str, Model],
    arguments: argparse.Namespace,
) -> dict[str, Any]:
    """Time all in one interleaved run; the whole result as plain values."""
    size: Size = arguments.size
    where = machine(threads=arguments.threads, rounds=arguments.rounds)
    models: dict[str, Model] = {name: model for name, (model, _) in done.items()}
    models |= peers
    opened = [
        open_timed(name, model, size, threads=arguments.threads) for name, model in models.items()
    ]
    timed = [item for item in opened if item is not None]
    if len(timed) < len(opened):
        raise SystemExit(f"error: a file of fixed size does not take {size[0]}x{size[1]}")
    measure(timed, size, rounds=arguments.rounds)
    rows = figures(timed, timed[0])
    for row in rows:
        row["scores"] = done[row["network"]][1] if row["network"] in done else {}
    return {"machine": where, "size": size, "rows": rows, "front": find_fronts(rows)}


def find_fronts(rows: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Return, a figure, the networks that none beats in both that figure and time; fast first."""
    fronts = {}
    for key, (_, _, more_is_better) in FIGURES.items():
        sign = -1 if more_is_better else 1
        points = sorted(
            (row["median_ms"], sign * row["scores"][key], row["network"])
            for row in rows
            if key in row["scores"]
        )
        best = float("inf")
        fronts[key] = []
        for _, value, name in points:
            if value < best:
                best = value
                fronts[key].append(name)
    return fronts


def to_table(document: dict[str, Any]) -> str:
    """A line a network; what is on a front is bold."""
    shown = [key for key in FIGURES if any(key in row["scores"] for row in document["rows"])]
    height, width = document["size"]
    first = document["rows"][0]["network"]
    titles = ["network", *(FIGURES[key][0] for key in shown), "params M", "GMACs", "ms"]
    titles += [f"ratio to {first}"]
    lines = [
        f"{describe(document['machine'])}; {height} x {width}; bold: on the front of that figure",
        "",
        "| " + " | ".join(titles) + " |",
        "|" + "---|" * len(titles),
    ]
    for row in document["rows"]:
        cells = [row["network"]]
        for key in shown:
            value = row["scores"].get(key)
            text = "" if value is None else f"{value * FIGURES[key][1]:.1f}"
            is_best = row["network"] in document["front"][key]
            cells.append(f"**{text}**" if is_best else text)
        cells += [f"{row['params_m']:.2f}", f"{row['gmacs']:.2f}", f"{row['median_ms']:.1f}"]
        cells += [f"{row['ratio']:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def draw(document: dict[str, Any], path: Path) -> None:
    """A panel a figure: every network at its milliseconds, the front as a line, peers dashed."""
    rows = document["rows"]
    keys = [key for key in PLOTTED if any(key in row["scores"] for row in rows)]
    figure, panels = plt.subplots(1, len(keys), figsize=(5.5 * len(keys), 4.5), squeeze=False)
    height, width = document["size"]
    for panel, key in zip(panels[0], keys, strict=True):
        title, factor, _ = FIGURES[key]
        at = {
            row["network"]: (row["median_ms"], factor * row["scores"][key])
            for row in rows
            if key in row["scores"]
        }
        panel.plot(*zip(*at.values(), strict=True), "o", color="tab:blue", alpha=0.7)
        front = [at[name] for name in document["front"][key]]
        panel.plot(*zip(*front, strict=True), "-", color="tab:orange", drawstyle="steps-post")
        for name, point in at.items():
            panel.annotate(name, point, xytext=(4, 4), textcoords="offset points", fontsize=7)
        for row in rows:
            if not row["scores"]:
                panel.axvline(row["median_ms"], linestyle="--", color="gray", linewidth=0.8)
                panel.text(
                    row["median_ms"],
                    0.02,
                    row["network"],
                    rotation=90,
                    fontsize=7,
                    ha="right",
                    transform=panel.get_xaxis_transform(),
                )
        panel.set_xlabel(f"ms at {height} x {width}")
        panel.set_title(title)
        panel.grid(alpha=0.3)
        panel.set_xlim(left=0)
    figure.tight_layout()
    try:
        with atomic_file(path) as file:
            figure.savefig(file, format="png", dpi=110)
    finally:
        plt.close(figure)


if __name__ == "__main__":
    main()
