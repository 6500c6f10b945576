"""The rotation at which returns fit the image best, and its uncertainty."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from runtime.base.arrays import Float64
from runtime.checks.fit import Angles, fit_of
from runtime.checks.view import View

# Blur of the boundaries in image heights, step of yaw and pitch [degrees], largest number of
# moves.
_LEVELS = ((8 / 375, 1.5, 4), (5 / 375, 0.75, 4), (3 / 375, 0.5, 3), (2 / 375, 0.3, 3))
_ROLL_STEP = 2.5  # steps of roll are so many times as large, because it moves returns less
_LONGEST_MOVE, _ARRIVED = 1.5, 0.3  # in steps
# Places around the current one at which the sum is computed, in steps: the place itself, and the
# sides and corners of a cube.
_FACES = [way * side for side in np.eye(3) for way in (-1, 1)]
_CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
_CUBE = np.array([(0, 0, 0), *_FACES, *_CORNERS], np.float64)
_PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
_TERMS = np.column_stack(
    [np.ones(len(_CUBE)), _CUBE, *(_CUBE[:, i] * _CUBE[:, j] for i, j in _PAIRS)]
)
_FIT = np.linalg.pinv(_TERMS)
_RESAMPLES, _BLOCKS = 200, 10  # of the bootstrap; frames are drawn in at most so many blocks
_FARTHEST_STEPS = 15.0  # used if the parabola of a resample has no maximum nearby


class Optimum(NamedTuple):
    """The rotation at which the mean of both figures is largest.

    Attributes:
        angles: float64 (3,), yaw, pitch and roll [degrees] by which returns are turned.
        error: float64 (3,), standard error [degrees] from a bootstrap over blocks of frames; large
            if there is no maximum.
    """

    angles: Float64
    error: Float64


def scores_of(views: Sequence[View], angles: Angles = (0, 0, 0), **blur: float) -> Float64:
    """The boundary figure plus the correlation of each view, turned by these angles, (frames,)."""
    fits = [fit_of(view, angles, **blur) for view in views]
    return np.array([fit.edge + fit.depth_correlation for fit in fits])


def find_rotation(views: Sequence[View]) -> Optimum:
    """Return the best rotation near the given one, and its standard error."""
    angles = _climb(views)
    blur, step, _ = _LEVELS[-1]
    sums, sides = _around(views, angles, blur, step), _sides(step)
    return Optimum(angles + _best_of(_FIT @ sums.mean(axis=0)) * sides, _bootstrap(sums) * sides)


def held_out_gain(views: Sequence[View]) -> tuple[float, float]:
    """Return how much better frames fit with the rotation that the other half of them finds.

    The result is the mean gain of their scores over the given rotation, and its standard error.
    """
    half = (len(views) + 1) // 2
    halves = (views[:half], views[half:]), (views[half:], views[:half])
    gains = [scores_of(there, _climb(here)) - scores_of(there) for here, there in halves]
    both = np.concatenate(gains)
    return float(both.mean()), float(both.std(ddof=1) / np.sqrt(len(both)))


def _climb(views: Sequence[View]) -> Float64:
    """Move repeatedly to the maximum of a parabola through the sums around the current place."""
    angles = np.zeros(3)
    for blur, step, moves in _LEVELS:
        for _ in range(moves):
            move = _best_of(_FIT @ _around(views, angles, blur, step).mean(axis=0))
            length = max(float(np.abs(move).max()), 1e-9)
            angles = angles + move * min(1, _LONGEST_MOVE / length) * _sides(step)
            if length < _ARRIVED:
                break
    return angles


def _sides(step: float) -> Float64:
    return step * np.array([1, 1, _ROLL_STEP])


def _around(views: Sequence[View], angles: Float64, blur: float, step: float) -> Float64:
    """The sums of each view, (frames, places of the cube)."""
    places = angles + _CUBE * _sides(step)
    return np.column_stack([scores_of(views, place, blur=blur) for place in places])


def _best_of(terms: Float64) -> Float64:
    """Where the parabola with these ten terms is largest, in steps; uphill if it has no maximum."""
    slope, bend = terms[1:4], np.zeros((3, 3))
    for (row, column), term in zip(_PAIRS, terms[4:], strict=True):
        bend[row, column] += term
        bend[column, row] += term
    curvatures, axes = np.linalg.eigh(bend)
    along = axes.T @ slope
    far = np.sign(along) * _FARTHEST_STEPS
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.where(curvatures < 0, -along / curvatures, far)
    return np.asarray(axes @ np.clip(np.nan_to_num(steps), -_FARTHEST_STEPS, _FARTHEST_STEPS))


def _bootstrap(sums: Float64) -> Float64:
    """The standard error of the maximum, in steps, from resampled blocks of frames."""
    blocks = np.array_split(np.arange(len(sums)), min(len(sums), _BLOCKS))
    if len(blocks) < 2:
        return np.full(3, _FARTHEST_STEPS)
    terms = np.stack([_FIT @ sums[block].sum(axis=0) for block in blocks])
    random = np.random.default_rng(0)
    drawn = random.integers(len(blocks), size=(_RESAMPLES, len(blocks)))
    places = np.stack([_best_of(terms[each].sum(axis=0)) for each in drawn])
    # Quantiles are used because a few resamples have no maximum. In a normal distribution two
    # standard errors lie between them.
    low, high = np.quantile(places, [0.16, 0.84], axis=0)
    few = np.sqrt(len(blocks) / (len(blocks) - 1))
    return np.asarray((high - low) / 2 * few)
