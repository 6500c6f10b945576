"""Pictures of the frames with the largest errors: truth, answers, and where these are wrong."""

import colorsys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arrays import Size
from runtime.contract.contract import NO_CLASS, ClassInfo
from runtime.drawing.encode import encode_jpeg
from runtime.drawing.overlay import Overlay
from training.datasets.class_mapping import list_classes
from training.pages.pictures import enlarge_returns
from training.scores.evaluated_set import EvaluatedSet
from training.scores.score_set import Result, Row
from training.scores.scored_model import ScoredModel
from training.scores.scoring import HeadMaps
from training.scores.shared_classes import ScoredClasses

_WIDEST, _QUALITY = 420, 80  # of a panel
# Number of frames that are drawn for each model, set and head.
WORST = 10
# Depth is wrong from this share of the true depth on.
WRONG_SHARE = 0.1
_GOLDEN = 0.618  # of a turn of the hue, between two classes without a colour
# BGR colours of right pixels, and of those that the model, the other and both have wrong.
_RIGHT, _WRONG = (90, 90, 90), (60, 60, 235)
_OTHER_WRONG, _BOTH_WRONG = (235, 150, 40), (235, 235, 235)


@dataclass(frozen=True)
class WorstFrame:
    """A frame with a large error of a model.

    Attributes:
        row: the score of the model with the error on the set.
        other: the model that is drawn beside it; "" if there is none.
        head: "semantic" or "depth".
        name: name of the frame.
        error: share of wrong pixels, or MAE [m].
        other_error: error of the other model; None if there is none.
        panels: JPEG pictures by title.
        legend: name and colour (red, green, blue) of the classes; () for the depth.
    """

    row: Row
    other: str
    head: str
    name: str
    error: float
    other_error: float | None
    panels: Mapping[str, bytes]
    legend: Sequence[tuple[str, tuple[int, int, int]]] = ()


def draw_worst(
    results: Sequence[Result],
    models: Mapping[str, ScoredModel],
    sets: Sequence[EvaluatedSet],
) -> Iterator[WorstFrame]:
    """Draw the frames with the largest errors of each model, set and head, with the first input.

    The first model is drawn beside each other model, and the second beside the first.

    Args:
        results: see `compare`.
        models: the open models by title.
        sets: the open sets.
    """
    for data in sets:
        found = [result for result in results if result.row.data == data.title]
        first = [result for result in found if result.feed == found[0].feed]
        for result in first:
            other = next((item for item in first if item is not result), None)
            pair = [item for item in (result, other) if item is not None]
            for head in ("semantic", "depth"):
                yield from _draw(pair, models, data, head)


def _draw(
    pair: Sequence[Result],
    models: Mapping[str, ScoredModel],
    data: EvaluatedSet,
    head: str,
) -> Iterator[WorstFrame]:
    errors = {
        item.row.model: {
            frame.index: error for frame in item.frames if (error := frame.error(head)) is not None
        }
        for item in pair
    }
    row, drawn = pair[0].row, [name for name, found in errors.items() if found]
    if row.model not in drawn:
        return
    other = drawn[1] if len(drawn) > 1 else ""
    colors = class_colors(data.classes)
    overlay = Overlay(colors, data.farthest_m)
    legend = [(info.name, info.color) for info in colors] if head == "semantic" else ()
    of_row = errors[row.model]
    for index in sorted(of_row, key=lambda index: -of_row[index])[:WORST]:
        sample, _ = data.read(index)
        ((_, _, frame, fed),) = data.split(sample, index, [pair[0].feed])
        maps: dict[str, NDArray[Any]] = {
            name: data.answer(models[name], frame.sample, fed, index).heads[head] for name in drawn
        }
        if head == "semantic":
            truth: NDArray[Any] = sample.semantic
            known = truth != NO_CLASS
            wrong = [np.not_equal(values, truth) for values in maps.values()]
        else:
            target = np.where(frame.target <= data.farthest_m, frame.target, np.float32(0))
            known = target > 0
            dense, dot_px = known.mean() > 0.5, 1 + 2 * max(1, target.shape[1] // _WIDEST)
            truth = target if dense else enlarge_returns(target, dot_px)
            wrong = [np.abs(values - target) > WRONG_SHARE * target for values in maps.values()]
        pictures = overlay.panels(frame.sample.rgb, HeadMaps(), widest=_WIDEST)
        for title, values in {"truth": truth, **maps}.items():
            shown = overlay.panels(None, HeadMaps(**{head: values}), widest=_WIDEST)
            (pictures[title],) = shown.values()
        size = next(iter(pictures.values())).shape[:2]
        pictures["where they are wrong" if other else "where it is wrong"] = _mark(
            known, wrong, size
        )
        panels = {
            title: bytes(encode_jpeg(each, quality=_QUALITY)) for title, each in pictures.items()
        }
        yield WorstFrame(
            *(row, other, head, sample.name),
            of_row[index],
            errors[other].get(index) if other else None,
            panels,
            legend,
        )


def _mark(
    known: NDArray[np.bool_], wrong: Sequence[NDArray[np.bool_]], size: Size
) -> NDArray[np.uint8]:
    """Colour the pixels that are right, and those that a model, another and both have wrong."""
    colors = np.zeros((*known.shape, 3), np.uint8)
    colors[known] = _RIGHT
    colors[known & wrong[0]] = _WRONG
    if len(wrong) > 1:
        colors[known & wrong[1]] = _OTHER_WRONG
        colors[known & wrong[0] & wrong[1]] = _BOTH_WRONG
    if known.mean() < 0.5:  # single returns would vanish
        window = np.ones((1 + 2 * (known.shape[1] // size[1]), 3), np.uint8)
        colors = np.asarray(cv2.dilate(colors, window), np.uint8)
    return np.asarray(cv2.resize(colors, size[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)


def class_colors(classes: ScoredClasses) -> tuple[ClassInfo, ...]:
    """Return the scored classes with the colours of the set, or with generated ones."""
    known = {info.name.lower(): info.color for info in list_classes(classes.table)}
    found = []
    for at, name in enumerate(classes.names):
        color = known.get(name.lower(), (0, 0, 0))
        if not any(color):
            parts = colorsys.hsv_to_rgb(_GOLDEN * at % 1, 0.65, 0.9)
            red, green, blue = (round(255 * part) for part in parts)
            color = red, green, blue
        found.append(ClassInfo(name, color))
    return tuple(found)
