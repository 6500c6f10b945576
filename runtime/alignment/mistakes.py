"""The usual mistakes in extrinsics, by name, and which of them makes the returns fit the image."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.alignment.fit_scores import LEAST_CORRELATION, fit_scores
from runtime.alignment.view import View

_LEAST_GAIN = 0.1  # least gain of the sum of both figures over the given calibration
_FRAMES = 5
# From the axes of a LiDAR or vehicle (x ahead, y left, z up) to those of a camera.
_TO_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])

_Matrix = NDArray[np.float64]
_Undo = Callable[[_Matrix], _Matrix]
_SAME = np.eye(4)


class Mistake(NamedTuple):
    """A mistake in extrinsics.

    Attributes:
        text: what seems to be wrong.
        undo: returns extrinsics without the mistake.
    """

    text: str
    undo: _Undo


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


def _inverse(given: _Matrix) -> _Matrix:
    return np.asarray(np.linalg.inv(given), np.float64)


def _turned(*, then: _Matrix = _SAME, first: _Matrix = _SAME, of: _Undo = np.array) -> _Undo:
    return lambda given: then @ of(given) @ first


def _usual_mistakes() -> Iterator[Mistake]:
    yield Mistake("the matrix seems to be camera to LiDAR: take its inverse", _inverse)
    yield Mistake("its rotation seems to be camera to LiDAR: transpose it", _transposed)
    swapped = "the axes of camera (z ahead) and LiDAR (x ahead, z up) seem to be swapped"
    for turn in (_TO_CAMERA, _TO_CAMERA.T):
        yield Mistake(f"{swapped}: turn the result of the matrix", _turned(then=turn))
        yield Mistake(f"{swapped}: turn the points first", _turned(first=turn))
        both = f"{swapped}, and the matrix to be camera to LiDAR"
        yield Mistake(both, _turned(then=turn, of=_inverse))
    for axis, name in enumerate("xyz"):
        for count in (2, 1, 3):
            text = f"the LiDAR seems to be turned by {90 * count} degrees about its {name} axis"
            yield Mistake(text, _turned(first=_quarters(axis, count)))
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
    total_as_given, _ = _fit(views)
    fits = [_fit(without(views, each)) for each in USUAL_MISTAKES]
    total, correlation = max(fits)
    is_clear = correlation >= LEAST_CORRELATION and total >= total_as_given + _LEAST_GAIN
    return USUAL_MISTAKES[fits.index((total, correlation))] if is_clear else None


def without(views: Sequence[View], mistake: Mistake) -> list[View]:
    """The views with extrinsics in which a mistake is undone."""
    return [view.with_extrinsics(mistake.undo(view.calibration.extrinsics)) for view in views]


def _fit(views: Sequence[View]) -> tuple[float, float]:
    """Medians of the sum of both figures and of the depth figure; 0 if returns miss the image."""
    figures = [fit_scores(view) if view.has_structure else (0.0, 0.0) for view in views]
    edges, correlation = np.array(figures).T
    return float(np.median(edges + correlation)), float(np.median(correlation))
