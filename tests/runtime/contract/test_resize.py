"""The one resize rule against plain loops, exact fractions and hand-made pictures."""

from fractions import Fraction

import numpy as np
import pytest

from runtime.contract.resize import (
    move_returns,
    move_scan_lines,
    resize_image,
    resize_nearest,
    resize_surface,
)

SIZE = (30, 47)
# Shrinking, growing, whole, odd and half factors, and one side each way.
SIZES = [(10, 20), (15, 94), (29, 46), (30, 48), (45, 71), (60, 94), (90, 20), (13, 141), (7, 200)]


def moved_pixel(index, old, new):
    """The pixel of a moved centre, in exact fractions; Python rounds half to even, too."""
    return round((Fraction(index) + Fraction(1, 2)) * new / old - Fraction(1, 2))


def scan(size=SIZE, share=0.2, seed=0):
    random = np.random.default_rng(seed)
    depth = np.where(random.random(size) < share, random.uniform(1, 80, size), 0)
    line = np.where(depth > 0, random.integers(0, 64, size), -1)
    return depth.astype(np.float32), line.astype(np.int16)


def move_by_loop(depth, line, size):
    moved, moved_line = np.zeros(size, np.float32), np.full(size, -1, np.int16)
    for row, column in np.argwhere(depth):
        place = (
            moved_pixel(int(row), depth.shape[0], size[0]),
            moved_pixel(int(column), depth.shape[1], size[1]),
        )
        if moved[place] == 0 or depth[row, column] < moved[place]:
            moved[place], moved_line[place] = depth[row, column], line[row, column]
    return moved, moved_line


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_returns_move_to_the_pixel_of_their_centre_and_the_nearest_stays(size):
    depth, line = scan()
    expected, expected_line = move_by_loop(depth, line, size)
    moved = move_returns(depth, size)
    assert moved.dtype == np.float32
    np.testing.assert_array_equal(moved, expected)
    with_lines = move_scan_lines(depth, line, size)
    np.testing.assert_array_equal(with_lines[0], expected)
    np.testing.assert_array_equal(with_lines[1], expected_line)
    assert with_lines[1].dtype == np.int16


def test_what_is_no_measurement_is_not_moved_and_hides_no_return():
    depth = np.zeros((4, 4), np.float32)
    depth[0, 0], depth[0, 1] = np.nan, 5
    depth[2, 2], depth[2, 3] = -3, 6
    with np.errstate(invalid="raise"):
        assert move_returns(depth, (2, 2)).tolist() == [[5, 0], [0, 6]]


# --- pictures ----------------------------------------------------------------------------------


def mean_over_area(values, new):
    """The mean of (old, ...) over each of `new` equal stretches, by shares of pixels."""
    old = len(values)
    out = np.zeros((new, *values.shape[1:]))
    for index in range(new):
        start, end = Fraction(index * old, new), Fraction((index + 1) * old, new)
        for pixel in range(old):
            share = max(Fraction(0), min(end, pixel + 1) - max(start, pixel))
            out[index] += float(share / (end - start)) * values[pixel]
    return out


def linear(values, new):
    """(old, ...) at the centres of `new` pixels, by straight lines between centres."""
    old = len(values)
    at = np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)
    low = np.minimum(at.astype(int), old - 2)
    share = (at - low).reshape(-1, *[1] * (values.ndim - 1))
    return values[low] * (1 - share) + values[low + 1] * share


def by_hand(picture, size):
    """Each side for itself: by area where it shrinks, by lines where it grows."""
    out = picture.astype(np.float64)
    for axis in (0, 1):
        turned = np.moveaxis(out, axis, 0)
        shrinks = size[axis] < len(turned)
        turned = (mean_over_area if shrinks else linear)(turned, size[axis])
        out = np.moveaxis(turned, 0, axis)
    return out


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_pictures_go_by_area_along_what_shrinks_and_by_lines_along_what_grows(size):
    picture = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    resized = resize_image(picture, size)
    assert resized.dtype == np.uint8
    # OpenCV rounds after each side.
    assert np.abs(resized - by_hand(picture, size)).max() < 1.6


# --- labels and dense depth --------------------------------------------------------------------


def nearest_sources(index, old, new):
    """The old pixels nearest to the centre of a new one: two, if it lies half-way."""
    centre, remainder = divmod((2 * index + 1) * old, 2 * new)
    return [centre - 1, centre] if remainder == 0 else [centre]


@pytest.mark.parametrize("size", [(30, 47), *SIZES], ids=str)
def test_labels_and_dense_depth_take_the_nearest_centre(size):
    random = np.random.default_rng(0)
    semantic = random.choice(np.array([0, 10, 255], np.uint8), SIZE)
    depth = random.uniform(0, 80, SIZE).astype(np.float32)
    for values in (semantic, depth):
        resized = resize_nearest(values, size)
        assert resized.dtype == values.dtype
        assert resized.shape == size
        for row in range(size[0]):
            for column in range(size[1]):
                assert resized[row, column] in [
                    values[source_row, source_column]
                    for source_row in nearest_sources(row, SIZE[0], size[0])
                    for source_column in nearest_sources(column, SIZE[1], size[1])
                ]


# --- predicted depth ---------------------------------------------------------------------------


def enlarged_by_loops(depth, size):
    """Each pixel from the pixels around its nearest centre."""
    out = np.empty(size, np.float32)
    padded = np.pad(depth, 1, mode="edge")
    nearest = resize_nearest(np.arange(depth.size, dtype=np.int32).reshape(depth.shape), size)
    for row, column in np.ndindex(size):
        at = divmod(int(nearest[row, column]), depth.shape[1])
        around = padded[at[0] : at[0] + 3, at[1] : at[1] + 3]
        out[row, column] = depth[at]
        if around.min() > 0 and around.max() <= 1.15 * around.min():
            v = np.clip((row + 0.5) * depth.shape[0] / size[0] - 0.5, 0, depth.shape[0] - 1)
            u = np.clip((column + 0.5) * depth.shape[1] / size[1] - 0.5, 0, depth.shape[1] - 1)
            top, left = int(v), int(u)
            bottom = min(top + 1, depth.shape[0] - 1)
            right = min(left + 1, depth.shape[1] - 1)
            upper = (1 - u + left) / depth[top, left] + (u - left) / depth[top, right]
            lower = (1 - u + left) / depth[bottom, left] + (u - left) / depth[bottom, right]
            out[row, column] = 1 / ((1 - v + top) * upper + (v - top) * lower)
    return out


@pytest.mark.parametrize("size", [(20, 27), (31, 40), (9, 50)])
def test_predicted_depth_is_smooth_within_a_surface_and_never_mixed(size):
    random = np.random.default_rng(0)
    depth = (random.uniform(1.0, 1.04, (9, 13)) * np.linspace(5, 9, 13)).astype(np.float32)
    depth[:, 7:] *= 4
    depth[2, 2] = 0
    answer = resize_surface(depth, size)
    assert answer.dtype == np.float32
    np.testing.assert_allclose(answer, enlarged_by_loops(depth, size), rtol=1e-4)
    assert not ((answer > 9) & (answer < 4 * 5)).any()
