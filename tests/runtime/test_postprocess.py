"""Checking and resizing of answers against plain loops."""

import numpy as np
import pytest

from runtime.postprocess import faults, resize_output


def nearest_sources(index: int, old: int, new: int) -> list[int]:
    """The old pixels nearest to the centre of a new one: two, if it lies half-way."""
    centre, remainder = divmod((2 * index + 1) * old, 2 * new)
    return [centre - 1, centre] if remainder == 0 else [centre]


def assert_nearest(resized, values):
    (height, width), (old_height, old_width) = resized.shape, values.shape
    for row in range(height):
        for column in range(width):
            assert resized[row, column] in [
                values[source_row, source_column]
                for source_row in nearest_sources(row, old_height, height)
                for source_column in nearest_sources(column, old_width, width)
            ]


@pytest.mark.parametrize("size", [(30, 40), (15, 20), (60, 80), (37, 55), (13, 29)])
def test_classes_and_depth_take_the_nearest_centre(size):
    random = np.random.default_rng(0)
    semantic = random.choice(np.array([0, 10, 255], np.uint8), (30, 40))
    depth = random.uniform(0, 80, (30, 40)).astype(np.float32)
    for head, values in (("semantic", semantic), ("depth", depth)):
        resized = resize_output(head, values, size)
        assert resized.dtype == values.dtype
        assert resized.shape == size
        assert_nearest(resized, values)


def test_boundary_is_bilinear_between_pixel_centres():
    boundary = np.array([[0, 1], [0, 1]], np.float32)
    expected = [0, 0.25, 0.75, 1]  # centres at 1/4 and 3/4 of the width
    assert resize_output("boundary", boundary, (2, 4))[0].tolist() == expected


def test_a_boundary_shrunk_far_skips_no_line():
    boundary = np.zeros((40, 400), np.float32)
    boundary[:, 203] = 1
    assert resize_output("boundary", boundary, (40, 70)).max() > 0.1
    logits = np.stack([boundary, -boundary])
    assert resize_output("semantic_logits", logits, (60, 70))[1].min() < -0.1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("head", ["depth", "boundary", "semantic_logits"])
def test_one_value_that_is_not_finite_is_found_anywhere(head, bad):
    for at in range(17 * 19):
        values = np.zeros((17, 19), np.float32)
        values.flat[at] = bad
        assert faults({head: values}, num_classes=1) == (f"{head}_not_finite",)


def test_only_ids_with_a_name_are_valid():
    semantic = np.zeros((5, 5), np.uint8)
    semantic[4, 4] = 10
    assert faults({"semantic": semantic}, num_classes=11) == ()
    assert faults({"semantic": semantic}, num_classes=10) == ("semantic_unknown_class",)
