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
from training.scores.differences import Difference
from training.scores.metrics import RANGES_M, RETURN_DISTANCES
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
# For each head: its answers, and what the colours of the last picture mean.
_MARKS = {
    "semantic": ("classes", "Colours of the last picture: red = wrong here, blue = in the other, "),
    "depth": (
        "depth",
        f"Wrong by over {WRONG_SHARE:.0%} of the depth: red = here, blue = in the other, ",
    ),
}
# The colours of verdicts.
_JUDGED = {"better": "good", "worse": "bad"}


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
    text = f"{verdict} than {against}" if verdict in _JUDGED else verdict
    return text, _JUDGED.get(verdict, "soft")


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
        points = [
            (scale, error, f"uncertainty {scale:.3g} m, error {error:.3g} m")
            for scale, error in item.scores.uncertainty.reliability()
        ]
        if not points:
            continue
        axis = _logarithmic([value for *both, _ in points for value in both if value > 0])
        chart = _scatter(
            points,
            "error [m]",
            axis="depth_uncertainty [m]",
            note="Mean error of tenths of the pixels by their uncertainty. On the dashed line "
            "the uncertainty is right; above it, it is too small.",
            axes=(axis, axis),
        )
        chart |= {"lines": [_line(chart)], "dashed": ["0,100 100,0"]}
        chart["label"] = f"error of {item.row.model}"
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
        chart = _scatter(
            [(ms, value, f"{name}: {ms:.1f} ms, {value:.1f}") for ms, value, name in spots],
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
        chart["lines"] = [_line(chart)]
        yield f"{title} during the training", "", chart


# The place in percent of a value on an axis, and the values of its ticks.
_Axis = tuple[Callable[[float], float], Sequence[float]]


def _scatter(
    points: Sequence[tuple[float, float, str]],
    quantity: str,
    *,
    axis: str,
    note: str,
    axes: tuple[_Axis, _Axis] | None = None,
) -> dict[str, Any]:
    """Return the values of chart.html for points, each with its words; None: on axes from 0."""
    across, up, _ = zip(*points, strict=True)
    (x, columns), (y, rows) = axes or (_linear(max(across)), _linear(max(up)))
    return {
        "ticks": [(100 - y(tick), tick) for tick in rows],
        "along": [(x(tick), tick) for tick in columns],
        "unit": "",
        "lines": [],
        "deadline": [],
        "unanswered": [],
        "points": [("point", x(one), 100 - y(other), text) for one, other, text in points],
        "quantity": quantity,
        "axis": axis,
        "label": quantity,
        "note": note,
    }


def _line(chart: Mapping[str, Any]) -> str:
    """Return the line through the points of a chart."""
    return " ".join(f"{x:.2f},{y:.2f}" for _, x, y, _ in chart["points"])


def _linear(most: float) -> _Axis:
    """Return an axis from 0 to a round number of at least `most`."""
    power = 10.0 ** math.floor(math.log10(most or 1))
    end = next(step * power for step in (1, 2, 2.5, 5, 10) if step * power >= most)
    return lambda value: 100 * value / end, [end * tick / _TICKS for tick in range(_TICKS + 1)]


def _logarithmic(values: Sequence[float]) -> _Axis:
    """Return an axis between powers of ten that hold the values, with these as ticks."""
    low = math.floor(math.log10(min(values)))
    high = max(math.ceil(math.log10(max(values))), low + 1)

    def place(value: float) -> float:
        return 100 * (math.log10(max(value, 10.0**low)) - low) / (high - low)

    return place, [10.0**power for power in range(low, high + 1)]


def _worst(frames: Sequence[WorstFrame]) -> Iterator[tuple[str, list[Any], list[dict[str, Any]]]]:
    """Yield heading, legend and frames for each model, set and head."""
    for (key, head), group in itertools.groupby(frames, lambda frame: (frame.row.key, frame.head)):
        found = list(group)
        model, data, lidar, _ = key
        what, marks = _MARKS[head]
        yield (
            f"Worst {what} of {model} on {data}, LiDAR {lidar}",
            [*found[0].legend, (f"{marks}white = in both", (235, 235, 235))],
            [
                {
                    "name": frame.name,
                    "words": _words(frame),
                    "panels": [
                        (title, f"data:image/jpeg;base64,{base64.b64encode(picture).decode()}")
                        for title, picture in frame.panels.items()
                    ],
                }
                for frame in found
            ],
        )


def _words(frame: WorstFrame) -> str:
    is_share = frame.head == "semantic"
    shown = [
        f"{100 * error:.1f} %" if is_share else f"{1000 * error:.0f} mm"
        for error in (frame.error, frame.other_error)
        if error is not None
    ]
    text = f"{'wrong pixels' if is_share else 'MAE'} {shown[0]}"
    return text if len(shown) < 2 else f"{text}, {frame.other} {shown[1]}"
