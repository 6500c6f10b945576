"""Linear interpolation of inverse depth, on planes and beside them."""

import numpy as np
import pytest

from training.evaluation.classical.linear import Linear


def complete(sparse_depth):
    return Linear().complete(np.zeros((*sparse_depth.shape, 3), np.uint8), sparse_depth)


def plane(height=40, width=60):
    """A tilted plane, 4 to 60 m."""
    v, u = np.mgrid[:height, :width]
    return (1 / (0.016 + 0.005 * v + 0.0005 * u)).astype(np.float32)


@pytest.mark.parametrize("pattern", ["lines", "random"])
def test_a_plane_is_exact_between_its_returns(pattern):
    depth = plane()
    kept = np.zeros(depth.shape, bool)
    if pattern == "lines":
        kept[3::9, 5:55:3] = True
    else:
        kept.flat[np.random.default_rng(0).choice(depth.size, 60, replace=False)] = True
        kept[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    answer = complete(np.where(kept, depth, np.float32(0)))
    inside = np.s_[3:-4, 5:53] if pattern == "lines" else np.s_[:, :]
    np.testing.assert_allclose(answer[inside], depth[inside], rtol=1e-5)


def test_beyond_the_triangles_the_nearest_return_fills():
    sparse_depth = np.zeros((20, 20), np.float32)
    sparse_depth[[5, 5, 14, 14], [5, 14, 5, 14]] = 10, 20, 10, 20
    answer = complete(sparse_depth)
    assert answer[0, 0] == answer[19, 3] == 10
    assert answer[2, 19] == 20
    assert 1 / answer[9, 10] == pytest.approx(1 / 10 + 5 / 9 * (1 / 20 - 1 / 10), rel=1e-5)


@pytest.mark.parametrize("at", [([4, 4, 4], [1, 5, 9]), ([2, 4, 6], [2, 4, 6]), ([3, 8], [1, 2])])
def test_returns_on_one_line_fill_as_the_nearest(at):
    sparse_depth = np.zeros((10, 10), np.float32)
    sparse_depth[at] = np.arange(5, 5 + len(at[0]))
    answer = complete(sparse_depth)
    assert set(np.unique(answer)) == set(sparse_depth[at])
    assert (answer[at] == sparse_depth[at]).all()
