"""The tables of comparison.py, from the files that it wrote."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from comparison_entries import ONNX, SCORES, TIMES, Entry, Heads, read_json
from models.checkpoint import RECIPE

# Titles of the columns for "set lidar" among the scores.
DEPTH_COLUMNS = {
    "streets 64": "KITTI streets, 64 lines",
    "streets 16": "16 lines",
    "stream own": "KITTI frames 50-59, 32 lines",
    "rendered 64": "rendered, 64 lines",
}


def to_tables(heads: Heads, runs: Path) -> str:
    """Return a table for each task; a missing figure is an empty cell."""
    times = read_json(runs / TIMES)
    sizes = [f"{part['size'][0]} x {part['size'][1]}" for part in times.get("sizes", [])]
    parts = []
    for head, title in (("semantic", "Semantics"), ("depth", "Depth completion, MAE / RMSE in mm")):
        columns = ["CamVid val mIoU %", "published, test"]
        if head == "depth":
            columns = list(DEPTH_COLUMNS.values())
        columns = ["network", "trained", *columns, "params M", "GMACs"]
        columns += [f"ms, {size}" for size in sizes]
        lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
        for entry, answers in heads.items():
            if head in answers:
                lines.append(f"| {' | '.join(_row(entry, head, runs, times))} |")
        parts.append(f"**{title}**\n\n" + "\n".join(lines))
    if times:
        parts.append(f"GMACs at {sizes[0]}. {times['machine']}.")
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
    timed = [part["rows"].get(entry.name, {}) for part in times.get("sizes", [])]
    counted = [timed[0].get(key) if timed else None for key in ("params_m", "gmacs")]
    cells += ["" if value is None else f"{value:.3g}" for value in counted]
    for row in timed:
        digits = 1 if row and row["median_ms"] < 100 else 0
        cells.append(f"{row['median_ms']:.{digits}f}" if row else "")
    return cells


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
