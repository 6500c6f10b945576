"""Decoded frames are kept as long as they fit, and never change what is read."""

import numpy as np
import pytest

from training.datasets.camvid import CamVidRecipe
from training.datasets.sample import Sample
from training.loading.augment import AugmentConfig
from training.loading.cache import CachedSource
from training.loading.checked import CheckedSource
from training.loading.open_dataset import open_mixture
from training.recipe import DataRecipe

#: rgb, depth and classes of 10 x 10 pixels.
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
        return Sample(rgb, targets, None, str(index), scan_line=line)


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


def test_a_smaller_frame_may_still_fit_after_a_larger_one_did_not():
    counted = Counted()
    source = CachedSource(counted, limit_bytes=BYTES)
    read(source, [2, 2, 0, 0])
    assert counted.decoded == [2, 2, 0]


@pytest.mark.parametrize(("limit", "decoded"), [(BYTES + 200, 1), (BYTES + 199, 2)])
def test_scan_lines_count_too(limit, decoded):
    counted = Counted(with_lines=True)
    read(CachedSource(counted, limit_bytes=limit), [0, 0])
    assert len(counted.decoded) == decoded


@pytest.mark.parametrize(("limit", "decoded"), [(BYTES + 100, 1), (BYTES + 99, 2)])
def test_road_masks_count_too(limit, decoded):
    class Masked(Counted):
        def __getitem__(self, index):
            sample = super().__getitem__(index)
            return sample.with_targets(road_mask=np.zeros(sample.size, np.uint8))

    counted = Masked()
    read(CachedSource(counted, limit_bytes=limit), [0, 0])
    assert len(counted.decoded) == decoded


def test_mixture_shares_the_recipes_memory_among_workers_and_sets():
    mixture_length = 20

    def decoded(cache_bytes, *, workers, sets):
        sources = [Counted(2) for _ in range(sets)]
        recipe = DataRecipe(
            tuple(CamVidRecipe(path=str(index)) for index in range(sets)),
            augment=AugmentConfig(crop=(32, 32)),
            workers=workers,
            cache_gib=cache_bytes / 2**30,
        )
        mixture = open_mixture(recipe, sources, length=mixture_length)
        for index in range(len(mixture)):
            mixture[index]
        return max(len(source.decoded) for source in sources)

    assert decoded(0, workers=1, sets=1) == mixture_length
    assert decoded(2 * BYTES, workers=0, sets=1) == 2
    assert decoded(2 * BYTES, workers=1, sets=1) == 2
    assert decoded(4 * BYTES, workers=2, sets=1) == 2
    assert decoded(4 * BYTES, workers=1, sets=2) == 2
    assert decoded(2 * BYTES, workers=2, sets=1) > 2


def test_checked_source_brings_every_frame_to_one_size():
    source = CheckedSource(Counted(), (5, 6))
    assert len(source) == 4
    assert {source[index].size for index in range(4)} == {(5, 6)}
    assert (source[3].depth == 4.0).all()
    assert source[3].name == "3"
