"""Nearest filling against a search through all returns."""

import numpy as np
import pytest

from training.evaluation.classical.nearest import Nearest


def complete(sparse_depth):
    return Nearest().complete(np.zeros((*sparse_depth.shape, 3), np.uint8), sparse_depth)


@pytest.mark.parametrize("seed", range(4))
def test_the_return_taken_is_the_nearest_but_for_the_mask(seed):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(40, 90, 2)
    at = rng.choice(height * width, 25, replace=False)
    sparse_depth = np.zeros((height, width), dtype=np.float32)
    sparse_depth.flat[at] = np.arange(1, 26)  # each depth names its return
    taken = complete(sparse_depth).astype(int) - 1
    rows, columns = np.divmod(at, width)
    v, u = np.mgrid[:height, :width]
    distance = np.hypot(v[..., None] - rows, u[..., None] - columns)  # to every return
    to_taken = np.take_along_axis(distance, taken[..., None], axis=-1)[..., 0]
    assert (to_taken <= 1.05 * distance.min(axis=-1)).all()
