"""Evaluation rows as a table and JSON."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from runtime.files.atomic_write import atomic_write
from training.evaluation.depth_regions import REGIONS, RETURN_DISTANCES
from training.evaluation.metrics import FARTHEST_M, RANGES_M
from training.evaluation.scoring import scored_classes


class _Column(NamedTuple):
    """A figure, shown times ``factor``; without --all only if it is a main one."""

    key: str
    title: str
    factor: float
    main: bool = False


#: Columns in order; those without a value are left out.
_COLUMNS = (
    _Column("miou", "mIoU %", 100.0, main=True),
    _Column("category_miou", "mIoU cat %", 100.0),
    _Column("accuracy", "Acc %", 100.0, main=True),
    _Column("mean_accuracy", "mAcc %", 100.0),
    _Column("fwiou", "fwIoU %", 100.0),
    _Column("road_iou", "road IoU %", 100.0, main=True),
    _Column("mae_m", "MAE [m]", 1.0, main=True),
    *(_Column(f"mae_m_{a:g}_{b:g}", f"MAE {a:g}-{b:g} m", 1.0) for a, b in RANGES_M),
    *(
        _Column(f"mae_m_{region}", f"MAE {title} [mm]", 1000.0)
        for region, title in zip(
            RETURN_DISTANCES,
            ("at a return", "1-2 px from it", "3-6 px from it", "> 6 px from it"),
            strict=True,
        )
    ),
    _Column("rmse_m", "RMSE [m]", 1.0, main=True),
    _Column("median_m", "median error [m]", 1.0, main=True),
    *(_Column(f"rmse_m_{a:g}_{b:g}", f"RMSE {a:g}-{b:g} m", 1.0) for a, b in RANGES_M[:2]),
    _Column("imae_per_km", "iMAE [1/km]", 1.0),
    _Column("irmse_per_km", "iRMSE [1/km]", 1.0),
    *(
        _Column(f"{error}_m_{region}", f"{region} {error.upper()} [mm]", 1000.0)
        for region in REGIONS
        for error in ("mae", "rmse")
    ),
    *(
        _Column(f"mae_m_confident_{share}", f"MAE of the most confident {share} % [mm]", 1000.0)
        for share in (50, 80, 100)
    ),
    _Column("coverage_1", "errors within 1 scale %", 100.0, main=True),
    _Column("coverage_2", "errors within 2 scales %", 100.0),
    _Column("mae_px", "disparity MAE [px]", 1.0, main=True),
    _Column("rmse_px", "disparity RMSE [px]", 1.0),
    _Column("boundary_precision", "boundary P %", 100.0),
    _Column("boundary_recall", "boundary R %", 100.0),
    _Column("boundary_f", "boundary F %", 100.0, main=True),
)
#: Head -> a figure of every set with its ground truth, and the key of that truth in `folders`.
_TRUTH = {"semantic": ("miou", "labels"), "depth": ("mae_m", "depth")}
#: Of that truth, what is not scored.
_UNSCORED = {
    "labels": "the labelled images has no class and is not scored",
    "depth": f"the depth is beyond {FARTHEST_M:g} m and not scored; check its unit (depth_scale)",
}


@dataclass(frozen=True)
class Row:
    """What one model scored on one set with one LiDAR and one fault.

    Attributes:
        figures: over the pixels of all frames, in SI units and shares; empty without ground truth.
        places: figures by place, where the set knows the places of its frames and has several.
        figures_over_places: the mean over these places, see `scoring.figures_over_places`.
        heads: what the model answered.
        labelled: class -> its labelled pixels, and the frames that show it.
        left_out: classes that are not scored, in words; empty without any.
        unscored: "labels" or "depth" -> the share of its pixels that is not scored.
    """

    model: str
    engine: str
    data: str
    lidar: str
    fault: str
    frames: int
    figures: dict[str, float]
    places: dict[str, dict[str, float]] = field(default_factory=dict)
    figures_over_places: dict[str, float] = field(default_factory=dict)
    heads: Sequence[str] = ()
    labelled: dict[str, tuple[int, int]] = field(default_factory=dict)
    left_out: str = ""
    unscored: dict[str, float] = field(default_factory=dict)


def format_table(rows: Sequence[Row], *, all_columns: bool = False) -> str:
    """Lay rows out as a Markdown table, with what could not be scored below it.

    Columns that no row has are left out. A row with places has a second line, the mean over them.

    Args:
        rows: what was scored.
        all_columns: show every figure, not the main ones alone.
    """
    known = [column for column in _COLUMNS if any(column.key in row.figures for row in rows)]
    columns = [column for column in known if all_columns or column.main]
    notes = []
    if len(columns) < len(known):
        notes.append(f"{len(known) - len(columns)} more metrics with --all or --json")
    titles = ["model", "data", "frames", "LiDAR"]
    titles += ["engine"] if all_columns else []
    titles += ["fault"] if all_columns or any(row.fault != "none" for row in rows) else []
    cells = [[*titles, *(column.title for column in columns)]]
    for row in rows:
        notes += [row.left_out] if row.left_out else []
        if over := scored_classes(row.figures):
            notes.append(f"{row.model} on {row.data}: mIoU{over}, the others are not labelled")
        for head, (figure, truth) in _TRUTH.items():
            explained = head == "semantic" and row.left_out
            if share := row.unscored.get(truth):
                notes.append(f"{row.data}: {100 * share:.3g} % of {_UNSCORED[truth]}")
            elif head in row.heads and figure not in row.figures and not explained:
                notes.append(
                    f"{row.data}: none of the {row.frames} frames has {truth} as ground truth; "
                    f"use a set with it, for example folders:DIR,{truth}=FOLDER"
                )
        if not row.figures:
            notes.append(f"{row.model} on {row.data}, LiDAR {row.lidar}: nothing to score")
            continue
        lines = [(str(row.frames), row.figures)]
        if row.places:
            lines.append((f"mean over {len(row.places)} places", row.figures_over_places))
        for frames, figures in lines:
            values = [
                f"{figures[column.key] * column.factor:.3f}" if column.key in figures else ""
                for column in columns
            ]
            words = {"model": row.model, "data": row.data, "frames": frames, "LiDAR": row.lidar}
            words |= {"engine": row.engine, "fault": row.fault}
            cells.append([*(words[title] for title in titles), *values])
    notes = list(dict.fromkeys(notes))
    if len(cells) == 1:
        return "\n".join(notes)
    widths = [max(len(line[index]) for line in cells) for index in range(len(cells[0]))]
    table = [
        "| "
        + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        + " |"
        for line in cells
    ]
    table.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join([*table, *notes])


def write_json(rows: Sequence[Row], path: Path) -> None:
    """Write every figure of every row; one that nothing was measured for is null.

    Raises:
        OutputError: if the file cannot be written.
    """
    documents = [_without_nan(asdict(row)) for row in rows]
    atomic_write(path, json.dumps(documents, indent=2, allow_nan=False).encode())


def _without_nan(value: Any) -> Any:
    """Return the document with null in place of NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value
