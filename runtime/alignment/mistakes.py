"""The usual mistakes in extrinsics, by name, and which of them makes the returns fit the image."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.alignment.figures import LEAST_ALIKE, figures_of
from runtime.alignment.view import View

_LEAST_GAIN = 0.1  # least gain of the sum of both figures over the given calibration
_FRAMES = 5
# From the axes of a LiDAR or vehicle (x ahead, y left, z up) to those of a camera.
_TO_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])

_Matrix = NDArray[np.float64]


class Mistake(NamedTuple):
    """A mistake in extrinsics.

    Attributes:
        text: what seems to be wrong.
        undo: returns extrinsics without the mistake.
    """

    text: str
    undo: Callable[[_Matrix], _Matrix]


def _transposed(given: _Matrix) -> _Matrix:
    mixed = given.copy()
    mixed[:3, :3] = given[:3, :3].T
    return mixed


def _in_metres(units: float) -> _Matrix:
    factors = np.ones((4, 4))
    factors[:3, 3] /= units
    return factors


def _quarters(axis: int, count: int) -> _Matrix:
    """A rotation by so many quarter turns about an axis of the LiDAR."""
    first, second = (each for each in range(3) if each != axis)
    sine, cosine = (0, 1, 0, -1)[count], (1, 0, -1, 0)[count]
    turn = np.eye(4)
    turn[first, first] = turn[second, second] = cosine
    turn[first, second], turn[second, first] = -sine, sine
    return turn


def _usual_mistakes() -> Iterator[Mistake]:
    inverse = "the matrix seems to be camera to LiDAR"
    yield Mistake(f"{inverse}: take its inverse", np.linalg.inv)
    yield Mistake("its rotation seems to be camera to LiDAR: transpose it", _transposed)
    swapped = "the axes of camera (z ahead) and LiDAR (x ahead, z up) seem to be swapped"
    for turn in (_TO_CAMERA, _TO_CAMERA.T):
        yield Mistake(f"{swapped}: turn the result of the matrix", partial(np.matmul, turn))
        yield Mistake(f"{swapped}: turn the points first", lambda given, turn=turn: given @ turn)
        yield Mistake(
            f"{swapped}, and the matrix to be camera to LiDAR",
            lambda given, turn=turn: turn @ np.linalg.inv(given),
        )
    for axis, name in enumerate("xyz"):
        for count in (2, 1, 3):
            turn, degrees = _quarters(axis, count), 90 * count
            text = f"the LiDAR seems to be turned by {degrees} degrees about its {name} axis"
            yield Mistake(text, lambda given, turn=turn: given @ turn)
    for units, name in ((100, "centimetres"), (1000, "millimetres")):
        text = f"its position seems to be in {name}: divide it by {units}"
        yield Mistake(text, partial(np.multiply, _in_metres(units)))


USUAL_MISTAKES = tuple(_usual_mistakes())


def find_mistake(views: Sequence[View]) -> Mistake | None:
    """Return the mistake that seems to have been made; None if there is none.

    Without this mistake the returns fit the images clearly better.

    Args:
        views: views of some frames, which may have no return in the image.
    """
    views = views[:: -(-len(views) // _FRAMES)]
    given, _ = _fit(views)
    fits = [_fit(without(views, each)) for each in USUAL_MISTAKES]
    total, alike = max(fits)
    is_clear = alike >= LEAST_ALIKE and total >= given + _LEAST_GAIN
    return USUAL_MISTAKES[fits.index((total, alike))] if is_clear else None


def without(views: Sequence[View], mistake: Mistake) -> list[View]:
    """The views with extrinsics in which a mistake is undone."""
    return [view.with_extrinsics(mistake.undo(view.calibration.extrinsics)) for view in views]


def _fit(views: Sequence[View]) -> tuple[float, float]:
    """Medians of the sum of both figures and of the depth figure; 0 if returns miss the image."""
    figures = [figures_of(view) if view.has_structure else (0.0, 0.0) for view in views]
    edges, alike = np.array(figures).T
    return float(np.median(edges + alike)), float(np.median(alike))
