"""A made-up predictor shows what cutting columns changes."""

import numpy as np
import pytest

from stability import changed_share
from training.datasets.sample import Sample, make_frame
from training.scores.scoring import HeadMaps

ROAD, SKY = 3, 0


def test_changes_far_from_returns_and_below_the_sky_are_counted():
    """The depth of the lower half follows the width of the image, at a rate of 2 % a column."""
    rgb, returns = np.zeros((40, 100, 3), np.uint8), np.zeros((40, 100), np.float32)
    returns[:, 90] = 20  # columns 84 to 96 are not counted

    def predict(rgb, sparse_depth, focal_length_px):
        depth = np.full(rgb.shape[:2], 20.0, np.float32)
        depth[20:] *= 1.02 ** (100 - rgb.shape[1])
        semantic = np.full(rgb.shape[:2], ROAD, np.uint8)
        semantic[:10] = SKY
        return HeadMaps(semantic=semantic, depth=depth)

    frames = [Sample(make_frame(rgb, "a", returns=returns), {})] * 2
    counted = [100 - 32 - columns - 13 for columns in (1, 2, 3, 5, 8)]
    by_three_columns_and_more = sum(counted[2:]) / sum(counted)
    assert changed_share(predict, frames, sky=SKY) == pytest.approx(
        20 / 30 * by_three_columns_and_more
    )
    assert changed_share(predict, frames, sky=None) == pytest.approx(
        20 / 40 * by_three_columns_and_more
    )
