"""Checking, cleaning and resizing against hand-made cases and plain loops."""

import numpy as np
import pytest

from runtime import Cleaned, InputError
from runtime.preprocess import (
    check_rgb,
    check_sparse_depth,
    clean_sparse_depth,
    is_constant,
    resize_rgb,
    resize_sparse_depth,
)


def test_good_arrays_are_not_copied():
    rgb = np.zeros((40, 50, 3), np.uint8)
    depth = np.zeros((40, 50), np.float32)
    assert check_rgb(rgb) is rgb
    assert check_sparse_depth(depth, size=(40, 50)) is depth
    assert clean_sparse_depth(depth, max_depth_m=80)[0] is depth


def test_views_become_contiguous():
    bgr = np.random.default_rng(0).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    rgb = check_rgb(bgr[..., ::-1])
    assert rgb.flags.c_contiguous
    assert (rgb[..., 0] == bgr[..., 2]).all()


@pytest.mark.parametrize(
    ("rgb", "text"),
    [
        (np.zeros((40, 50, 3), np.float32), "uint8.*float32"),
        (np.zeros((40, 50, 3), np.int64), "uint8.*int64"),
        (np.zeros((3, 40, 50), np.uint8), r"channels come last.*transpose\(1, 2, 0\)"),
        (np.zeros((40, 50), np.uint8), r"\(H, W, 3\), got \(40, 50\)"),
        (np.zeros((40, 50, 4), np.uint8), r"got \(40, 50, 4\)"),
        (np.zeros((1, 40, 50, 3), np.uint8), r"got \(1, 40, 50, 3\)"),
        (np.zeros((31, 50, 3), np.uint8), "at least 32 x 32"),
        (np.zeros((0, 0, 3), np.uint8), "at least 32 x 32"),
        ([[1]], "numpy array, got list"),
        (None, "numpy array, got NoneType"),
    ],
)
def test_other_pictures_are_refused(rgb, text):
    with pytest.raises(InputError, match=text):
        check_rgb(rgb)


@pytest.mark.parametrize(
    ("depth", "text"),
    [
        (np.zeros((40, 50), np.uint16), "unit of integers is not known: convert to metres"),
        (np.zeros((40, 50), np.float64), r"astype\(np.float32\)"),
        (np.zeros((40, 50), np.float16), "float32 metres, got float16"),
        (np.zeros((40, 50, 1), np.float32), r"\(40, 50\), got \(40, 50, 1\)"),
        (np.zeros((50, 40), np.float32), r"\(40, 50\), got \(50, 40\)"),
        (None, "numpy array, got NoneType"),
    ],
)
def test_other_depth_maps_are_refused(depth, text):
    with pytest.raises(InputError, match=text):
        check_sparse_depth(depth, size=(40, 50))


def test_each_kind_of_impossible_depth_is_counted_and_removed():
    depth = np.zeros((4, 5), np.float32)
    depth[0] = [5, 80, np.nan, np.nan, np.nan]
    depth[1] = [np.inf, -np.inf, -1, -0.001, -2]
    depth[2] = [80.01, 655.35, -0.0, 1e-3, 0]
    before = depth.copy()
    kept, cleaned, returns = clean_sparse_depth(depth, max_depth_m=80)
    assert cleaned == Cleaned(nan=3, infinite=2, negative=3, too_far=2)
    assert cleaned.total == 10
    assert sorted(kept[kept != 0].tolist()) == pytest.approx([1e-3, 5, 80])
    assert returns == 3
    assert np.array_equal(depth, before, equal_nan=True), "the caller's array was written to"


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 81.0])
def test_a_single_bad_pixel_anywhere_is_seen(bad):
    for at in range(33 * 35):
        depth = np.ones((33, 35), np.float32)
        depth.flat[at] = bad
        kept, cleaned, returns = clean_sparse_depth(depth, max_depth_m=80)
        assert (cleaned.total, returns, kept.flat[at]) == (1, 33 * 35 - 1, 0)


def test_constant_pictures():
    rgb = np.full((40, 50, 3), (7, 8, 9), np.uint8)
    assert is_constant(rgb)
    rgb[39, 49, 2] = 10
    assert not is_constant(rgb), "one pixel away from the sampled grid differs"
    rgb[0, 0] = 99
    assert not is_constant(rgb)


def test_growing_depth_takes_the_nearest_centre():
    depth = np.arange(1, 13, dtype=np.float32).reshape(3, 4)
    grown = resize_sparse_depth(depth, (7, 9))
    for row in range(7):
        for column in range(9):
            source = depth[int((row + 0.5) * 3 / 7), int((column + 0.5) * 4 / 9)]
            assert grown[row, column] == source


@pytest.mark.parametrize("size", [(125, 414), (188, 621), (100, 1242), (60, 60), (400, 900)])
def test_shrinking_depth_neither_loses_nor_shifts_nor_mixes(size):
    random = np.random.default_rng(1)
    depth = np.where(random.random((375, 1242)) < 0.04, random.uniform(1, 80, (375, 1242)), 0)
    depth = depth.astype(np.float32)
    expected: dict[tuple[int, int], float] = {}
    for row, column in np.argwhere(depth):
        cell = (
            int((row + 0.5) * size[0] / 375),
            int((column + 0.5) * size[1] / 1242),
        )
        value = float(depth[row, column])
        expected[cell] = min(value, expected.get(cell, value))
    shrunk = resize_sparse_depth(depth, size)
    assert shrunk.shape == size
    assert shrunk.dtype == np.float32
    found = {(int(r), int(c)): float(shrunk[r, c]) for r, c in np.argwhere(shrunk)}
    assert found == expected


def test_an_empty_depth_map_stays_empty():
    assert not resize_sparse_depth(np.zeros((100, 100), np.float32), (40, 40)).any()


def test_a_picture_shrunk_far_keeps_what_bilinear_would_skip():
    rgb = np.zeros((160, 160, 3), np.uint8)
    rgb[:, ::5] = 255  # a fine grid: a fifth of the light
    small = resize_rgb(rgb, (32, 32))
    assert small.mean() == pytest.approx(51, abs=1)


@pytest.mark.parametrize("size", [(50, 70), (50, 400), (40, 70)])
def test_a_side_that_shrinks_far_skips_nothing_while_the_other_grows(size):
    for column in range(400):
        rgb = np.zeros((40, 400, 3), np.uint8)
        rgb[:, column] = 255
        assert resize_rgb(rgb, size).any(), column
        turned = resize_rgb(rgb.transpose(1, 0, 2), size[::-1])
        assert turned.shape == (*size[::-1], 3)
        assert turned.any(), column


def test_a_masked_array_is_refused():
    """Its mask would be lost, and what lies below it be taken for a measurement."""
    masked = np.ma.masked_array(np.full((40, 50), 5, np.float32), mask=True)
    with pytest.raises(InputError, match=r"masked.*filled\(0\)"):
        check_sparse_depth(masked, size=(40, 50))
    assert not check_sparse_depth(masked.filled(0), size=(40, 50)).any()
    with pytest.raises(InputError, match="mask would be lost"):
        check_rgb(np.ma.masked_array(np.zeros((40, 50, 3), np.uint8)))


def test_a_picture_keeps_its_place():
    rgb = np.zeros((60, 60, 3), np.uint8)
    rgb[:30] = 200
    resized = resize_rgb(rgb, (90, 40))
    assert (resized[:44] == 200).all()
    assert (resized[46:] == 0).all()


def test_returns_survive_when_one_side_grows_and_the_other_shrinks():
    sparse_depth = np.zeros((100, 1000), dtype=np.float32)
    sparse_depth[50, ::7] = 10.0  # 143 returns, each in a column of its own of 300
    resized = resize_sparse_depth(sparse_depth, (400, 300))
    assert np.count_nonzero(resized.any(axis=0)) == 143
