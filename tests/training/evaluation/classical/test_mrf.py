"""The Markov random field against a dense solution of its energy, written out in loops."""

import numpy as np
import pytest

from training.evaluation.classical.mrf import MRF


def scene(height, width, share=0.2, seed=0):
    rng = np.random.default_rng(seed)
    rgb = rng.integers(100, 130, (height, width, 3), dtype=np.uint8)
    depth = rng.uniform(2, 60, (height, width)).astype(np.float32)
    depth[rng.random((height, width)) > share] = 0
    depth.flat[0] = 5
    return rgb, depth


def dense_solution(rgb, sparse_depth, data_weight, edge_sharpness):
    """Solve for the depth at which the gradient of the energy vanishes, pair by pair."""
    height, width = sparse_depth.shape
    count = height * width
    system, wanted = np.zeros((count, count)), np.zeros(count)
    for v, u in np.ndindex(height, width):
        i = v * width + u
        if sparse_depth[v, u] > 0:
            system[i, i] += data_weight
            wanted[i] += data_weight * float(sparse_depth[v, u])
        for row, column in ((v, u + 1), (v + 1, u)):
            if row < height and column < width:
                unlike = (rgb[v, u].astype(float) - rgb[row, column]) / 255
                weight = max(np.exp(-edge_sharpness * (unlike**2).sum()), 1e-4)
                j = row * width + column
                system[[i, j], [i, j]] += weight
                system[[i, j], [j, i]] -= weight
    return np.linalg.solve(system, wanted).reshape(height, width)


@pytest.mark.parametrize("size", [(7, 9), (1, 12), (12, 1), (1, 1), (2, 2)])
@pytest.mark.parametrize(("data_weight", "edge_sharpness"), [(10.0, 1000.0), (0.5, 50.0)])
def test_it_is_the_minimum_of_the_energy(size, data_weight, edge_sharpness):
    rgb, sparse_depth = scene(*size)
    depth = MRF(data_weight, edge_sharpness).complete(rgb, sparse_depth)
    assert depth.dtype == np.float32
    wanted = dense_solution(rgb, sparse_depth, data_weight, edge_sharpness)
    np.testing.assert_allclose(depth, wanted, rtol=1e-4)
