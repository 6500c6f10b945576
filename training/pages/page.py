"""The page of `ssdnet-eval --page`: figures, differences and the worst frames in one HTML file."""

import base64
import itertools
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from runtime.command.html import render_template
from runtime.command.machine import machine_facts
from runtime.files.atomic_write import atomic_write
from training.pages.worst_frames import WRONG_SHARE, WorstFrame
from training.scores.depth_regions import RETURN_DISTANCES
from training.scores.differences import Difference
from training.scores.metrics import RANGES_M
from training.scores.score_report import COLUMNS, difference_rows, table_notes
from training.scores.score_set import Result

# (set, score) -> steps and values.
Curves = Mapping[tuple[str, str], Sequence[tuple[int, float]]]
_TICKS = 5
_LEAST = 0.005  # least share of a label that is written in the confusion

_TITLES = {column.key: column.title.removesuffix(" mm") for column in COLUMNS}
# Title, the meaning of a line, and the figures of each chart.
_BARS = (
    ("Error of the depth by distance", "distance", [f"mae_m_{a:g}_{b:g}" for a, b in RANGES_M[2:]]),
    ("Error by distance to the returns", "place", [f"mae_m_{name}" for name in RETURN_DISTANCES]),
)
_MARKS = (
    ("semantic", "Colours of the last picture: red = wrong here, blue = in the other, "),
    ("depth", f"Wrong by over {WRONG_SHARE:.0%} of the depth: red = here, blue = in the other, "),
)


def write_page(
    results: Sequence[Result],
    path: Path,
    *,
    differences: Sequence[Difference] = (),
    worst: Sequence[WorstFrame] = (),
    overwrite: bool = True,
    title: str = "",
    curves: Curves = MappingProxyType({}),
) -> None:
    """Write the page, HTML in UTF-8 without external resources.

    Args:
        results: the results, set by set, in each set the models in their order.
        path: path of the file.
        differences: see `compare`.
        worst: pictures of the worst frames.
        overwrite: whether an existing file is replaced.
        title: title of the page; "": the names of the models.
        curves: for each set and score, the steps and values of a training's validations.

    Raises:
        OutputError: if the file cannot be written.
    """
    facts = machine_facts()
    rows = [result.row for result in results]
    names = list(dict.fromkeys(row.model for row in rows))
    values = {
        "title": title or f"Evaluation of {', '.join(names)}",
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "machine": f"{facts.processor}, {facts.logical_cores} logical cores",
        "differences": [
            (item.row.model, item.row.data, *cells, *_judged(verdict, item.against))
            for item, cells, verdict in difference_rows(differences)
        ],
        "groups": list(_groups(results, curves)),
        "worst": list(_worst(worst)),
        "notes": table_notes(rows),
    }
    page = render_template("training.pages", "evaluation.html", values)
    atomic_write(path, page.encode(errors="backslashreplace"), overwrite=overwrite)


def _judged(verdict: str, against: str) -> tuple[str, str]:
    """Return a verdict in words, and the name of its colour."""
    colors = {"better": "good", "worse": "bad"}
    return (
        (f"{verdict} than {against}", colors[verdict]) if verdict in colors else (verdict, "soft")
    )


def _groups(results: Sequence[Result], curves: Curves) -> Iterator[dict[str, Any]]:
    """Yield what the page shows for each set with each input."""
    scored = [item for item in results if item.row.figures]
    for group in dict.fromkeys(item.row.title for item in scored):
        found = [item for item in scored if item.row.title == group]
        figures = [item.row.shown for item in found]
        rows = [("frames", [str(item.row.frames) for item in found])]
        for column in COLUMNS:
            cells = [column.show(each) for each in figures]
            rows += [(column.title, cells)] if any(cells) else []
        yield {
            "title": group,
            "models": [item.row.model for item in found],
            "rows": rows,
            "bars": list(_bars(found)),
            "charts": [*_curves(found, curves), *_reliability(found), *_latency(found)],
            "confusions": list(_confusions(found)),
        }


def _bars(found: Sequence[Result]) -> Iterator[dict[str, Any]]:
    figures = [item.row.figures for item in found]
    classes = [f"iou_{name}" for name in found[0].classes]
    tables = [("IoU of the classes, %", "class", classes, 100.0)]
    tables += [(f"{title}, MAE in mm", of, keys, 1000.0) for title, of, keys in _BARS]
    for title, of, keys, factor in tables:
        known = [key for key in keys if any(_is_known(each.get(key)) for each in figures)]
        most = max((each.get(key) or 0 for each in figures for key in known), default=0)
        rows = [
            (
                _TITLES.get(key, key.removeprefix("iou_")).removeprefix("MAE ").rstrip(","),
                [
                    (f"{factor * value:.1f}", 100 * value / (1 if factor == 100 else most or 1))
                    if (value := each.get(key)) is not None and _is_known(value)
                    else ("", 0)
                    for each in figures
                ],
            )
            for key in known
        ]
        if rows:
            yield {"title": title, "of": of, "rows": rows}


def _is_known(value: float | None) -> bool:
    return value is not None and not math.isnan(value)


def _confusions(found: Sequence[Result]) -> Iterator[tuple[str, Sequence[str], list[Any]]]:
    for item in found:
        matrix, rows = item.scores.semantic.confusion, []
        for name, counts in zip(item.classes, matrix, strict=True):
            if total := counts.sum():
                shares = (counts / total).tolist()
                cells = [(f"{100 * each:.0f}" if each >= _LEAST else "", each) for each in shares]
                rows.append((name, cells))
        if rows:
            yield item.row.model, item.classes, rows


def _reliability(found: Sequence[Result]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for item in found:
        points = item.scores.uncertainty.reliability()
        if not points:
            continue
        values = [value for point in points for value in point if value > 0]
        low = math.floor(math.log10(min(values)))
        high = max(math.ceil(math.log10(max(values))), low + 1)

        def place(value: float, low: int = low, high: int = high) -> float:
            return 100 * (math.log10(max(value, 10.0**low)) - low) / (high - low)

        ticks = [10.0**power for power in range(low, high + 1)]
        spots = [(place(scale), 100 - place(error)) for scale, error in points]
        chart = {
            **_axes(
                [(100 - place(tick), tick) for tick in ticks],
                [(place(tick), tick) for tick in ticks],
            ),
            "lines": [" ".join(f"{x:.2f},{y:.2f}" for x, y in spots)],
            "dashed": ["0,100 100,0"],
            "points": [
                ("point", x, y, f"uncertainty {scale:.3g} m, error {error:.3g} m")
                for (x, y), (scale, error) in zip(spots, points, strict=True)
            ],
            "quantity": "error [m]",
            "axis": "depth_uncertainty [m]",
            "label": f"error of {item.row.model}",
            "note": "Mean error of tenths of the pixels by their uncertainty. On the dashed line "
            "the uncertainty is right; above it, it is too small.",
        }
        yield f"Reliability of depth_uncertainty, {item.row.model}", "", chart


def _latency(found: Sequence[Result]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    timed = [item for item in found if item.row.latency_ms is not None]
    figures = (("miou", "mIoU %", 100.0), ("mae_m", "MAE mm", 1000.0))
    # PyTorch, ONNX Runtime and methods have a chart each: their times do not compare.
    engines = dict.fromkeys(item.row.engine for item in timed)
    for (key, title, factor), engine in itertools.product(figures, engines):
        spots = [
            (item.row.latency_ms or 0.0, factor * item.row.figures[key], item.row.model)
            for item in timed
            if item.row.engine == engine and _is_known(item.row.figures.get(key))
        ]
        if len(spots) < 2:
            continue
        points = [(ms, value, f"{name}: {ms:.1f} ms, {value:.1f}") for ms, value, name in spots]
        chart = _scatter(
            points,
            title,
            axis="median time of an answer [ms]",
            note="Times of this evaluation, which may share the machine with others; ssdnet-bench "
            "measures speed.",
        )
        places = zip(chart["points"], spots, strict=True)
        chart["names"] = [
            ("left" if x > 50 else "right", x, y, name) for (_, x, y, _), (_, _, name) in places
        ]
        yield f"Accuracy and latency, {title}, {engine}", "", chart


def _curves(found: Sequence[Result], curves: Curves) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for (name, key), values in curves.items():
        if name != found[0].row.data or len(values) < 2:
            continue
        column = next((each for each in COLUMNS if each.key == key), None)
        title, factor = (column.title, column.factor) if column else (key, 1.0)
        points = [(step, factor * v, f"step {step}: {factor * v:.2f}") for step, v in values]
        note = "Every validation of the training; step 0 is that of the initial weights."
        chart = _scatter(points, title, axis="step", note=note)
        chart["lines"] = [" ".join(f"{x:.2f},{y:.2f}" for _, x, y, _ in chart["points"])]
        yield f"{title} during the training", "", chart


def _scatter(
    points: Sequence[tuple[float, float, str]], quantity: str, *, axis: str, note: str
) -> dict[str, Any]:
    """Return the values of chart.html for points, each with its words, on axes from 0."""
    x, last = _linear(max(along for along, _, _ in points))
    y, top = _linear(max(up for _, up, _ in points))
    return {
        **_axes(
            [(100 - y(tick), tick) for tick in _ticks(top)],
            [(x(tick), tick) for tick in _ticks(last)],
        ),
        "points": [("point", x(along), 100 - y(up), text) for along, up, text in points],
        "quantity": quantity,
        "axis": axis,
        "label": quantity,
        "note": note,
    }


def _axes(
    rows: Sequence[tuple[float, float]], columns: Sequence[tuple[float, float]]
) -> dict[str, Any]:
    """Return the values of chart.html for an empty chart with these ticks."""
    return {
        "ticks": rows,
        "along": columns,
        "unit": "",
        "lines": [],
        "deadline": [],
        "unanswered": [],
        "points": [],
    }


def _linear(most: float) -> tuple[Callable[[float], float], float]:
    """Return the place in percent of a value on an axis from 0, and the end of the axis."""
    power = 10.0 ** math.floor(math.log10(most or 1))
    end = next(step * power for step in (1, 2, 2.5, 5, 10) if step * power >= most)
    return lambda value: 100 * value / end, end


def _ticks(end: float) -> list[float]:
    return [end * tick / _TICKS for tick in range(_TICKS + 1)]


def _worst(frames: Sequence[WorstFrame]) -> Iterator[tuple[str, list[Any], list[dict[str, Any]]]]:
    """Yield heading, legend and frames for each model, set and head."""
    marks = dict(_MARKS)
    for (key, head), group in itertools.groupby(frames, lambda frame: (frame.row.key, frame.head)):
        found = list(group)
        model, data, lidar, _ = key
        what = "classes" if head == "semantic" else "depth"
        yield (
            f"Worst {what} of {model} on {data}, LiDAR {lidar}",
            [*found[0].legend, (f"{marks[head]}white = in both", (235, 235, 235))],
            [
                {
                    "name": frame.name,
                    "words": _words(frame),
                    "panels": [(title, _jpeg(picture)) for title, picture in frame.panels.items()],
                }
                for frame in found
            ],
        )


def _words(frame: WorstFrame) -> str:
    def show(error: float) -> str:
        return f"{100 * error:.1f} %" if frame.head == "semantic" else f"{1000 * error:.0f} mm"

    what = "wrong pixels" if frame.head == "semantic" else "MAE"
    text = f"{what} {show(frame.error)}"
    return text if frame.other_error is None else f"{text}, {frame.other} {show(frame.other_error)}"


def _jpeg(content: bytes) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
