"""Total generalised variation: planes, edges, and its energy against a second solver."""

from functools import partial

import numpy as np
import pytest
from scipy import optimize

from training.evaluation.classical.tgv import TGV, edge_tensor


def slanted(height, width):
    v, u = np.mgrid[:height, :width]
    return (10 + 0.21 * u + 0.13 * v).astype(np.float32)


def grey(size):
    return np.full((*size, 3), 90, np.uint8)


def energy(depth, slope, tensor, sparse_depth, method, rounding=0.0):
    """The energy of the module's docstring; `rounding` makes lengths smooth at 0."""
    xx, yy, xy = tensor
    right, down = np.zeros_like(depth), np.zeros_like(depth)
    right[:, :-1] = np.diff(depth, axis=1) - slope[0][:, :-1]
    down[:-1] = np.diff(depth, axis=0) - slope[1][:-1]
    steps = (xx * right + xy * down) ** 2 + (xy * right + yy * down) ** 2
    bends = np.zeros_like(depth)
    bends[:, :-1] += (np.diff(slope, axis=2) ** 2).sum(axis=0)
    bends[:-1] += (np.diff(slope, axis=1) ** 2).sum(axis=0)
    errors = (depth - sparse_depth)[sparse_depth > 0]
    return (
        method.smoothness * np.sqrt(steps + rounding**2).sum()
        + method.slope_smoothness * np.sqrt(bends + rounding**2).sum()
        + method.data_weight * (errors**2).sum()
    )


@pytest.mark.parametrize("size", [(30, 40), (61, 83)])  # without and with a pyramid
def test_a_slanted_plane_is_found_from_scattered_returns_whatever_the_picture(size):
    plane = slanted(*size)
    rng = np.random.default_rng(0)
    rgb = rng.integers(80, 140, (*size, 3), dtype=np.uint8)
    sparse_depth = np.where(rng.random(size) < 0.1, plane, 0)
    sparse_depth[[0, 0, -1, -1], [0, -1, 0, -1]] = plane[[0, 0, -1, -1], [0, -1, 0, -1]]
    depth = TGV(iterations=2000).complete(rgb, sparse_depth.astype(np.float32))
    np.testing.assert_allclose(depth, plane, atol=0.02)


def test_the_answer_has_the_least_energy():
    """A quasi-Newton method minimises the energy with lengths that are smoothed less and less."""
    rng = np.random.default_rng(1)
    size = height, width = 3, 4
    count = height * width
    rgb = rng.integers(0, 60, (*size, 3), dtype=np.uint8)
    sparse_depth = np.where(rng.random(size) < 0.4, rng.uniform(4, 6, size), 0).astype(np.float32)
    method = TGV(smoothness=0.3, slope_smoothness=0.2, iterations=4000)
    energy_of = partial(
        energy, tensor=edge_tensor(rgb, method), sparse_depth=sparse_depth, method=method
    )

    def split(x):
        return x[:count].reshape(size), x[count:].reshape(2, *size)

    def minimise(function, x):
        for rounding in (0.1, 0.01, 1e-3):
            x = optimize.minimize(partial(function, rounding=rounding), x, method="L-BFGS-B").x
        return x

    def of_both(x, rounding):
        return energy_of(*split(x), rounding=rounding)

    least = energy_of(*split(minimise(of_both, np.full(3 * count, 5.0))))

    def with_best_slope(depth):
        def of_slope(x, rounding):
            return energy_of(depth.astype(float), x.reshape(2, *size), rounding=rounding)

        slope = minimise(of_slope, np.zeros(2 * count)).reshape(2, *size)
        return energy_of(depth.astype(float), slope)

    assert with_best_slope(method.complete(rgb, sparse_depth)) == pytest.approx(least, rel=0.02)
    start = TGV(iterations=0).complete(rgb, sparse_depth)
    assert energy_of(start, np.zeros((2, *size))) > 1.1 * least


def test_a_step_falls_on_the_edge_of_the_picture():
    rgb = grey((24, 60))
    rgb[:, 37:] = 220
    sparse_depth = np.zeros((24, 60), np.float32)
    sparse_depth[:, :32], sparse_depth[:, 50:] = 10, 30  # halfway would be 41
    depth = TGV(iterations=2000).complete(rgb, sparse_depth)
    steps = np.diff(depth, axis=1)
    assert (steps[:, 36] > 15).all()
    assert (np.delete(steps, 36, axis=1) < 1).all()
    plain = TGV(iterations=2000).complete(grey((24, 60)), sparse_depth)
    assert np.diff(plain, axis=1).max() < 5
