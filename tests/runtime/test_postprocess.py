"""Checking and resizing of answers against plain loops."""

import numpy as np
import pytest

from runtime.postprocess import faults
from runtime.resize import resize_answer


def test_boundary_is_bilinear_between_pixel_centres():
    boundary = np.array([[0, 1], [0, 1]], np.float32)
    expected = [0, 0.25, 0.75, 1]  # centres at 1/4 and 3/4 of the width
    assert resize_answer("boundary", boundary, (2, 4))[0].tolist() == expected


def test_a_boundary_shrunk_far_skips_no_line():
    boundary = np.zeros((40, 400), np.float32)
    boundary[:, 203] = 1
    assert resize_answer("boundary", boundary, (40, 70)).max() > 0.1
    logits = np.stack([boundary, -boundary])
    assert resize_answer("semantic_logits", logits, (60, 70))[1].min() < -0.1


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
