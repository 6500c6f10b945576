"""The usual mistakes in extrinsics, by name, and which of them makes the returns fit the image."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.alignment.figures import figures_of
from runtime.alignment.view import View

ALIKE = 0.5  # least median depth figure of returns that fit; right 0.57 and more, wrong up to 0.07
_LEAST_GAIN = 0.1  # least gain of the sum of both figures over the given calibration
_FRAMES = 5
# From the axes of a LiDAR or vehicle (x ahead, y left, z up) to those of a camera.
_TO_CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])

_Matrix = NDArray[np.float64]


class Mistake(NamedTuple):
    """A mistake in a calibration.

    Attributes:
        text: what seems to be wrong.
        extrinsics: the given extrinsics without the mistake.
    """

    text: str
    extrinsics: _Matrix


def usual_mistakes(given: _Matrix) -> Iterator[Mistake]:
    """Yield the extrinsics that would be right if a usual mistake had been made."""
    inverse = np.asarray(np.linalg.inv(given), np.float64)
    yield Mistake("the matrix seems to be camera to LiDAR: take its inverse", inverse)
    mixed = given.copy()
    mixed[:3, :3] = given[:3, :3].T
    yield Mistake("its rotation seems to be camera to LiDAR: transpose it", mixed)
    swapped = "the axes of camera (z ahead) and LiDAR (x ahead, z up) seem to be swapped"
    for turn in (_TO_CAMERA, _TO_CAMERA.T):
        yield Mistake(f"{swapped}: turn the result of the matrix", turn @ given)
        yield Mistake(f"{swapped}: turn the points first", given @ turn)
        yield Mistake(f"{swapped}, and the matrix to be camera to LiDAR", turn @ inverse)
    for axis, name in enumerate("xyz"):
        for quarters in (2, 1, 3):
            text = f"the LiDAR seems to be turned by {90 * quarters} degrees about its {name} axis"
            yield Mistake(text, given @ _quarters(axis, quarters))
    for units, name in ((100, "centimetres"), (1000, "millimetres")):
        scaled = given.copy()
        scaled[:3, 3] /= units
        yield Mistake(f"its position seems to be in {name}: divide it by {units}", scaled)


def find_mistake(views: Sequence[View], scans: Sequence[NDArray[np.float32]]) -> int | None:
    """Return the index in `usual_mistakes` of the mistake that seems to have been made, or None.

    Without this mistake the returns fit the images clearly better.

    Args:
        views: views of some frames, which may have no return in the image.
        scans: the points of each frame, float32 (N, 3) or wider.
    """
    step = -(-len(views) // _FRAMES)
    views, scans = views[::step], scans[::step]
    given, _ = _fit(views)
    found = []
    for place, each in enumerate(
        zip(*(usual_mistakes(v.calibration.extrinsics) for v in views), strict=True)
    ):
        changed = [
            view.with_scan(points, replace(view.calibration, extrinsics=mistake.extrinsics))
            for view, points, mistake in zip(views, scans, each, strict=True)
        ]
        found.append((*_fit(changed), place))
    total, alike, place = max(found)
    return place if alike >= ALIKE and total >= given + _LEAST_GAIN else None


def _fit(views: Sequence[View]) -> tuple[float, float]:
    """Medians of the sum of both figures and of the depth figure; 0 if returns miss the image."""
    figures = [figures_of(view) if view.has_structure else (0.0, 0.0) for view in views]
    edges, alike = np.array(figures).T
    return float(np.median(edges + alike)), float(np.median(alike))


def _quarters(axis: int, count: int) -> _Matrix:
    """A rotation by so many quarter turns about an axis of the LiDAR."""
    first, second = (each for each in range(3) if each != axis)
    sine, cosine = (0, 1, 0, -1)[count], (1, 0, -1, 0)[count]
    turn = np.eye(4)
    turn[first, first] = turn[second, second] = cosine
    turn[first, second], turn[second, first] = -sine, sine
    return turn
