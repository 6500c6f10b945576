"""Decoded frames are kept as long as they fit, and never change what is read."""

import numpy as np
import pytest

from runtime.base.errors import DatasetError
from training.datasets.camvid import CamVidRecipe
from training.datasets.sample import Sample, make_frame
from training.loading.mixture import CachedSource
from training.loading.open_dataset import CheckedSource

# rgb, depth and classes of 10 x 10 pixels.
BYTES = 100 * (3 + 4 + 1)


class Counted:
    """Frames of (10, 10) or, from number 2 on, (20, 10) pixels; counts what is decoded."""

    def __init__(self, length=4, *, with_lines=False):
        self.length, self.with_lines, self.decoded = length, with_lines, []

    def __len__(self):
        return self.length

    def __getitem__(self, index):
        self.decoded.append(index)
        size = (20 if index >= 2 else 10, 10)
        depth = np.full(size, 1.0 + index, np.float32)
        line = np.zeros(size, np.int16) if self.with_lines else None
        rgb, semantic = np.zeros((*size, 3), np.uint8), np.zeros(size, np.uint8)
        targets = {"depth": depth, "semantic": semantic}
        return Sample(make_frame(rgb, str(index)), targets, line)


def read(source, order):
    """Names in the order they were read."""
    return [source[index].name for index in order]


def test_what_fits_is_decoded_once():
    counted = Counted()
    source = CachedSource(counted, limit_bytes=6 * BYTES)
    assert len(source) == 4
    assert read(source, [0, 1, 2, 3, 3, 2, 1, 0]) == list("01233210")
    assert counted.decoded == [0, 1, 2, 3]
    assert source[3] is source[3]


def test_what_no_longer_fits_is_decoded_anew_and_drops_nothing():
    counted = Counted()
    source = CachedSource(counted, limit_bytes=6 * BYTES - 1)
    assert read(source, [0, 1, 2, 3, 0, 1, 2, 3, 3]) == list("012301233")
    assert counted.decoded == [0, 1, 2, 3, 3, 3]


@pytest.mark.parametrize(("labels", "found"), [
    (np.zeros((9, 10), np.uint8), r"uint8 \(9, 10\)"),
    (np.zeros((10, 10), np.int64), r"int64 \(10, 10\)"),
])  # fmt: skip
def test_a_reader_without_proper_labels_is_named_with_its_frame(labels, found):
    wrong = Counted()[0].with_targets(semantic=labels)
    source = CheckedSource([wrong], CamVidRecipe(path="camvid"))
    text = rf"0: the reader list returned semantic = {found}; expected uint8 \(10, 10\)"
    with pytest.raises(DatasetError, match=text):
        source[0]
