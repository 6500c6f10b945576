"""The rows of an evaluation as a table and as JSON."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from training.scores.differences import Difference
from training.scores.metrics import RANGES_M, RETURN_DISTANCES
from training.scores.score_set import Row
from training.scores.scoring import OTHER, scored_classes


class Column(NamedTuple):
    """A figure, multiplied by `factor` and, without --all, shown only if it is a main one."""

    key: str
    title: str
    factor: float
    digits: int
    main: bool = False

    def show(self, figures: Mapping[str, float | None]) -> str:
        """Return its value, or "" if it was not measured."""
        value = figures.get(self.key)
        return "" if value is None else f"{value * self.factor:.{self.digits}f}"


def _share(key: str, title: str, *, main: bool = False) -> Column:
    return Column(key, f"{title} %", 100.0, 2, main)


def _metres(key: str, title: str, *, main: bool = False) -> Column:
    return Column(key, f"{title} mm", 1000.0, 1, main)


# Columns in order; those without a value are left out. Errors of depth are in millimetres.
COLUMNS = (
    _share("miou", "mIoU", main=True),
    _share("category_miou", "mIoU cat"),
    _share("accuracy", "Acc", main=True),
    _share("mean_accuracy", "mAcc"),
    _share("fwiou", "fwIoU"),
    _share("road_iou", "road IoU", main=True),
    _metres("mae_m", "MAE", main=True),
    *(_metres(f"mae_m_{a:g}_{b:g}", f"MAE at {a:g}-{b:g} m,") for a, b in RANGES_M),
    *(
        _metres(f"mae_m_{region}", f"MAE {title},")
        for region, title in zip(
            RETURN_DISTANCES,
            ("at a return", "1-2 px from it", "3-6 px from it", "> 6 px from it"),
            strict=True,
        )
    ),
    _metres("rmse_m", "RMSE", main=True),
    _metres("median_m", "median error", main=True),
    *(_metres(f"rmse_m_{a:g}_{b:g}", f"RMSE at {a:g}-{b:g} m,") for a, b in RANGES_M[:2]),
    # As KITTI's server has them; the figures above are over the pixels of all frames.
    _metres("mae_m_per_image", "MAE per image (KITTI),"),
    _metres("rmse_m_per_image", "RMSE per image (KITTI),"),
    Column("imae_per_km", "iMAE 1/km", 1.0, 3),
    Column("irmse_per_km", "iRMSE 1/km", 1.0, 3),
    *(
        _metres(f"mae_m_confident_{share}", f"MAE of the most confident {share} %,")
        for share in (50, 80, 100)
    ),
    _share("coverage_1", "errors within 1 scale", main=True),
    _share("coverage_2", "errors within 2 scales"),
    Column("mae_px", "disparity MAE px", 1.0, 3, main=True),
    Column("rmse_px", "disparity RMSE px", 1.0, 3),
    _share("boundary_precision", "boundary P"),
    _share("boundary_recall", "boundary R"),
    _share("boundary_f", "boundary F", main=True),
    Column("latency_ms", "an answer ms", 1.0, 1),
)
# For each head: a figure that every set with its ground truth has, and the key of that truth in
# `folders`.
_TRUTH = {"semantic": ("miou", "labels"), "depth": ("mae_m", "depth")}
# For each such truth: the part of it that is not scored.
_UNSCORED = {
    "labels": "the labelled pixels have no class and are not scored",
    "depth": "the depth is beyond {:g} m (--farthest) and not scored: check its unit (depth_scale)",
}


def format_table(
    rows: Sequence[Row], *, all_columns: bool = False, width: int | None = None
) -> str:
    """Lay out rows as Markdown tables, followed by what could not be scored.

    Figures that no row has are left out. A row with places has a second line, the mean over them.

    Args:
        rows: the scores.
        all_columns: show every figure, with a line for each figure and a column for each model;
            otherwise only the main ones are shown, with a line for each model.
        width: characters of the longest line, unless a single figure needs more; None: any.
    """
    scored = [row for row in rows if row.figures]
    known = _columns([key for row in scored for key in row.shown])
    columns = [column for column in known if all_columns or column.main]
    notes = table_notes(rows)
    if len(columns) < len(known):
        notes.insert(0, f"{len(known) - len(columns)} more figures with --all, --page or --json")
    if not scored:
        return "\n".join(notes)
    lay_out = _by_figure if all_columns else _by_model
    return "\n".join([*lay_out(scored, columns, width), *notes])


def format_differences(differences: Sequence[Difference], *, width: int | None = None) -> str:
    """Lay out the differences between models as a Markdown table with verdicts in words."""
    lines = []
    for against in dict.fromkeys(item.against for item in differences):
        found = [item for item in differences if item.against == against]
        cells = [["model", "data", "LiDAR", "figure", "change", "95 % interval", f"than {against}"]]
        for item, row, verdict in difference_rows(found):
            cells.append([item.row.model, item.row.data, *row, verdict])
        lines += ["", "", *_markdown(cells, keys=4, width=width)]
    return "\n".join(lines)


def difference_rows(
    differences: Sequence[Difference],
) -> Iterator[tuple[Difference, list[str], str]]:
    """Yield each difference with input, figure, change and interval in words, and its verdict."""
    for item in differences:
        lidar = item.row.lidar + f", {item.row.fault}" * (item.row.fault != "none")
        for column in _columns(item.figures):
            values = [column.factor * each for each in item.figures[column.key]]
            change, low, high = (f"{value:+.{column.digits}f}" for value in values)
            yield item, [lidar, column.title, change, f"{low} to {high}"], item.verdict(column.key)


def table_notes(rows: Sequence[Row]) -> list[str]:
    """Return what could not be scored, or not as it should be, each once."""
    notes = []
    for row in rows:
        notes += [row.left_out] if row.left_out else []
        classes_alone = "miou" in row.figures and "mae_m" not in row.figures
        if over := scored_classes(row.figures):
            notes.append(f"{row.model} on {row.data}: mIoU{over}, the others are not labelled")
        for head, (figure, truth) in _TRUTH.items():
            explained = row.left_out if head == "semantic" else classes_alone
            if share := row.unscored.get(truth):
                notes.append(
                    f"{row.data}: {100 * share:.3g} % of {_UNSCORED[truth].format(row.farthest_m)}"
                )
            elif head in row.heads and figure not in row.figures and not explained:
                notes.append(
                    f"{row.data}: none of the {row.frames} frames has {truth} as ground truth; "
                    f"use a set with it, for example folders:DIR,{truth}=FOLDER"
                )
        if row.without_focal and not classes_alone:
            notes.append(
                f"{row.model} on {row.data}: focal length of {row.without_focal} frames not known, "
                "on which its distances depend: give intrinsics=[fx,fy,cx,cy] in --data"
            )
        if not row.figures:
            notes.append(f"{row.model} on {row.data}, LiDAR {row.lidar}: nothing to score")
    return list(dict.fromkeys(notes))


def _columns(keys: Collection[str]) -> list[Column]:
    """Return the columns of figures; heads without one have theirs behind the others."""
    others = dict.fromkeys(key for key in keys if key.startswith(OTHER))
    every = *COLUMNS, *(Column(key, key.replace("_", " "), 1.0, 4, main=True) for key in others)
    return [column for column in every if column.key in keys]


def _by_model(rows: Sequence[Row], columns: Sequence[Column], width: int | None) -> list[str]:
    """Return a table with a line for each row."""
    keys = 4 + any(row.fault != "none" for row in rows)
    titles = ["model", "data", "frames", "LiDAR", "fault"][:keys]
    cells = [[*titles, *(column.title for column in columns)]]
    for row in rows:
        for frames, figures in _lines(row):
            words = [row.model, row.data, frames, row.lidar, row.fault][:keys]
            cells.append([*words, *(column.show(figures) for column in columns)])
    return _markdown(cells, keys, width)


def _by_figure(rows: Sequence[Row], columns: Sequence[Column], width: int | None) -> list[str]:
    """Return a table for each set and input, with a line for each figure."""
    lines: list[str] = []
    for title in dict.fromkeys(row.title for row in rows):
        found = [row for row in rows if row.title == title]
        parts = [(row, frames, figures) for row in found for frames, figures in _lines(row)]
        cells = [["figure", *(row.model for row, _, _ in parts)]]
        cells.append(["frames", *(frames for _, frames, _ in parts)])
        cells.append(["runs in", *(row.engine for row, _, _ in parts)])
        for column in columns:
            shown = [column.show(figures) for _, _, figures in parts]
            cells += [[column.title, *shown]] if any(shown) else []
        lines += [*([""] if lines else []), f"**{title}**", "", *_markdown(cells, 1, width)]
    return lines


def _lines(row: Row) -> list[tuple[str, Mapping[str, float | None]]]:
    """Return the number of frames in words, and the figures, for each line of a row."""
    lines: list[tuple[str, Mapping[str, float | None]]] = [(str(row.frames), row.shown)]
    if row.places:
        lines.append((f"mean over {len(row.places)} places", row.figures_over_places))
    return lines


def _markdown(cells: Sequence[Sequence[str]], keys: int, width: int | None) -> list[str]:
    """Return a table as lines; if it is too wide, several tables that repeat the first columns."""
    widths = [max(len(line[index]) for line in cells) for index in range(len(cells[0]))]
    blocks: list[list[int]] = [[]]
    free = least = (width or 10**9) - 1 - sum(3 + widths[index] for index in range(keys))
    for index in range(keys, len(widths)):
        if blocks[-1] and free < 3 + widths[index]:
            blocks.append([])
            free = least
        blocks[-1].append(index)
        free -= 3 + widths[index]
    lines: list[str] = []
    for block in blocks:
        chosen = [*range(keys), *block]
        table = [
            f"| {' | '.join(line[index].ljust(widths[index]) for index in chosen)} |"
            for line in cells
        ]
        table.insert(1, f"|{'|'.join('-' * (widths[index] + 2) for index in chosen)}|")
        lines += [*([""] if lines else []), *table]
    return lines


def list_figures(
    rows: Sequence[Row], differences: Sequence[Difference] = ()
) -> list[dict[str, Any]]:
    """Return every figure of every row for JSON; a figure for which nothing was measured is null.

    A row whose model was compared has "differences", with value, low, high and verdict of each
    figure, and "against", the model with which it was compared.
    """
    documents = []
    for row in rows:
        document = asdict(row)
        for item in differences:
            if item.row.key == row.key:
                document["against"] = item.against
                document["differences"] = {
                    figure: {**each._asdict(), "verdict": item.verdict(figure)}
                    for figure, each in item.figures.items()
                }
        documents.append(_without_nan(document))
    return documents


def _without_nan(value: Any) -> Any:
    """Return the document with null in place of NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value
