"""The crop that follows the data, and how much of a crop is padding."""

import numpy as np
import pytest

from runtime.errors import InputError
from training.datasets.sample import Sample
from training.loading.augment import AugmentConfig, with_crop


def sources(*sizes):
    return [[Sample(np.zeros((*size, 3), np.uint8), {}, None, "")] for size in sizes]


@pytest.mark.parametrize(
    ("sizes", "crop"),
    [
        ([(125, 414)], (96, 144)),
        ([(375, 1242)], (320, 480)),
        ([(375, 1242), (200, 300)], (192, 288)),
        ([(640, 256)], (320, 256)),
        ([(20, 20)], (32, 32)),
    ],
)
def test_the_crop_follows_the_smallest_frames(sizes, crop):
    assert with_crop(AugmentConfig(), sources(*sizes)).crop == crop


def test_a_stated_crop_is_kept():
    stated = AugmentConfig(crop=(320, 480))
    assert with_crop(stated, sources((125, 414))) == stated


def test_a_crop_that_is_too_small_for_two_views_is_refused():
    with pytest.raises(InputError, match=r"crop was set to \[96, 144\] .*; with pair_shift = 32"):
        with_crop(AugmentConfig(pair_shift=32), sources((125, 414)))
