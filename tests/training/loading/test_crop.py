"""The crop that follows the data, and how much of a crop is padding."""

import pytest

from runtime.errors import InputError
from training.loading.augment import AugmentConfig, with_crop


@pytest.mark.parametrize(
    ("size", "crop"),
    [
        ((125, 414), (96, 144)),
        ((375, 1242), (320, 480)),
        ((640, 256), (320, 256)),
        ((20, 20), (32, 32)),
    ],
)
def test_the_crop_follows_the_smallest_frame(size, crop):
    assert with_crop(AugmentConfig(), size).crop == crop


def test_a_stated_crop_is_kept():
    stated = AugmentConfig(crop=(320, 480))
    assert with_crop(stated, (125, 414)) == stated


def test_a_crop_that_is_too_small_for_two_views_is_refused():
    with pytest.raises(InputError, match=r"crop was set to \[96, 144\] .*; with pair_shift = 32"):
        with_crop(AugmentConfig(pair_shift=32), (125, 414))
