"""The crop of a training whose recipe has none, and how much of a crop is padding."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from runtime.contract import MIN_SIDE
from runtime.errors import InputError
from training.datasets.sample import SampleSource
from training.loading.augment import LARGEST_CROP, AugmentConfig

#: A crop's rows are a multiple of this: the stride of most networks.
_STEP = 32


def with_crop(augment: AugmentConfig, sources: Sequence[SampleSource]) -> AugmentConfig:
    """Return the ranges with a crop: as high as the first frame of each set, to `LARGEST_CROP`.

    Raises:
        InputError: if that is too small for second views.
    """
    if augment.crop is not None:
        return augment
    smallest = np.min([source[0].size for source in sources], axis=0)
    sides = np.minimum(smallest, LARGEST_CROP) // _STEP * _STEP
    height, width = (max(MIN_SIDE, int(side)) for side in sides)
    crop = (height, min(width, height * LARGEST_CROP[1] // LARGEST_CROP[0]))
    try:
        return replace(augment, crop=crop)
    except ValueError as error:
        raise InputError(
            f"data.augment.crop was set to {list(crop)} from the size of the data; with "
            f"pair_shift = {augment.pair_shift} the two views would not overlap. Set it to a "
            "larger size."
        ) from error


def padding_share(size: tuple[int, int], config: AugmentConfig) -> float:
    """Return the mean share of a crop that is beyond a frame of (height, width), 0..1."""
    scale = np.geomspace(*config.scale, num=101)
    height, width = (side / scale for side in config.size)
    inside = np.minimum(1, size[0] / height) * np.minimum(1, size[1] / width)
    return float(1 - inside.mean())
