"""Planes between returns: exact on planes, and against sums and fits written out in loops."""

import itertools

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from models import planes
from models.blocks import upsample
from models.planes import BASE_CELL, CELL, PlaneFit, fit_base

SIZE = (128, 192)


def places():
    rows, columns = torch.meshgrid(
        torch.arange(SIZE[0]).float(), torch.arange(SIZE[1]).float(), indexing="ij"
    )
    return rows[None, None], columns[None, None]


def road():
    """Inverse of the normalised depth of a tilted plane, at every pixel."""
    rows, columns = places()
    return 2 + 0.1 * rows + 0.03 * columns


def mask_of(pattern):
    mask = torch.zeros(1, 1, *SIZE)
    if pattern == "lines":
        mask[..., 3::20, ::2] = 1
    elif pattern == "tilted lines":
        rows, columns = places()
        mask[(rows + (columns / 7).round()) % 16 == 3] = 1
    else:
        rng = np.random.default_rng(0)
        mask[0, 0] = torch.from_numpy(rng.random(SIZE) < 0.004).float()
        mask[0, 0, :6], mask[0, 0, -6:] = 0, 0
    if pattern == "with a gap":
        mask[..., 40:80, 60:110] = 0
    return mask


def fit(inverse, mask) -> PlaneFit:
    """Fit the base in the cells; `inverse` is 0 where nothing is measured."""
    depth = mask / inverse.clamp(min=1)
    return fit_base(inverse, mask, F.max_pool2d(torch.cat([inverse, depth], dim=1), CELL))


def fitted(inverse, mask):
    """The base at the pixels, and the number of returns."""
    found = fit(inverse * mask, mask)
    return upsample(found.inverse_base, factor=BASE_CELL), found.return_count


def moments_of(place, values, weights=1.0):
    """Moments of returns at places (K, 2), below and to the right of the centre: (9,)."""
    r, c = place.T
    ones = np.ones(len(place))
    terms = np.stack([ones, r, c, values, r * r, c * c, r * c, values * r, values * c])
    return (terms * weights).sum(axis=1)


@pytest.mark.parametrize("pattern", ["lines", "tilted lines", "at random", "with a gap"])
def test_a_plane_is_exact_between_its_returns_whatever_their_pattern(pattern):
    mask = mask_of(pattern)
    found, count = fitted(road(), mask)
    assert count.sum() == mask.sum()
    error = (found / road() - 1).abs()[..., 24:-24, 24:-24]
    assert error.median() < 1e-4
    assert error.max() < 0.01


def test_two_planes_keep_their_slopes_up_to_the_step_between_them():
    rows, columns = places()
    inverse = torch.where(columns < 96, 2 + 0.1 * rows, 30 + 0.2 * columns)
    mask = mask_of("lines")
    found, _ = fitted(inverse, mask)
    error = (found / inverse - 1).abs()[..., 24:-24, 24:-24]
    distance = (columns[..., 24:-24, 24:-24] - 96).abs()
    assert error[distance > 32].max() < 0.02
    assert error[distance > 12].mean() < 0.05
    returns, plane = inverse[mask > 0], fit(inverse * mask, mask).inverse_plane
    assert returns.min() <= plane.min() <= plane.max() <= returns.max()


def test_beyond_the_returns_a_slope_is_not_continued():
    """The road goes up to the horizon; above the scan there are houses."""
    mask = mask_of("lines")
    mask[..., :64, :] = 0
    found, _ = fitted(road(), mask)
    highest_line = road()[..., 83:84, :]
    assert (found[..., :16, :] > 0.9 * highest_line).all()


def test_one_return_is_everywhere_in_reach_and_without_any_there_is_nothing():
    mask = torch.zeros(1, 1, *SIZE)
    mask[0, 0, 50, 70] = 1
    found, _ = fitted(torch.full_like(mask, 7.0), mask)
    assert torch.allclose(found, torch.tensor(7.0))
    nothing, share = fitted(road(), torch.zeros_like(mask))
    assert not nothing.any()
    assert not share.any()


def test_each_frame_of_a_batch_is_fitted_alone():
    first, second = mask_of("lines"), mask_of("at random")
    both = fit(torch.cat([road() * first, 2 * road() * second]), torch.cat([first, second]))
    alone = fit(2 * road() * second, second)
    for found, expected in zip(both, alone, strict=True):
        assert torch.allclose(found[1:], expected, rtol=1e-5)


def test_reduced_precision_around_it_does_not_reach_the_moments():
    mask = mask_of("lines")
    expected, _ = fitted(road(), mask)
    with torch.autocast("cpu", torch.bfloat16):
        found, _ = fitted(road(), mask)
    assert torch.equal(found, expected)


def test_the_base_passes_through_isolated_returns_that_a_plane_misses():
    mask = torch.zeros(1, 1, *SIZE)
    mask[..., 8::16, 8::16] = 1
    noise = torch.rand(mask.shape, generator=torch.Generator().manual_seed(0))
    inverse = road() * (0.975 + 0.05 * noise)
    found = fit(inverse * mask, mask)
    plane, base = (
        upsample(found.inverse_plane, factor=CELL),
        upsample(found.inverse_base, factor=BASE_CELL),
    )
    missed, passed = ((x / inverse - 1).abs()[mask > 0] for x in (plane, base))
    assert missed.median() > 0.0015
    assert passed.quantile(0.95) < 0.002


def test_a_return_of_another_surface_does_not_move_the_plane():
    mask = mask_of("lines")
    mask[..., 33, 96] = 1
    plane = fit(road() * mask, mask).inverse_plane
    for factor, moved in ((1.1, True), (1.0 + 2.0 * planes.MAX_RESIDUAL + 0.05, False)):
        moments = torch.zeros(1, 4, SIZE[0] // 2, SIZE[1] // 2)
        moments[0, 0, 16, 48], moments[0, 3, 16, 48] = 1, factor * road()[0, 0, 33, 97]
        flat = upsample(plane)
        assert bool((planes.add_residuals(flat, moments) - flat).abs().max() > 0.05) == moved


def test_the_difference_is_that_of_the_place_of_the_return_in_its_cell():
    """Returns on a slope, wherever they are in a cell, leave it as it is."""
    rows, columns = places()
    slope = 2 + 0.5 * rows + 0.3 * columns
    at_cells = F.avg_pool2d(slope, BASE_CELL)
    mask = mask_of("at random")
    pixels = torch.cat([mask, slope * mask], dim=1)
    found = planes.add_residuals(at_cells, planes.cell_moments(pixels, BASE_CELL, 4))
    inside = (found / at_cells - 1).abs()[..., 16:-16, 16:-16]
    assert inside.max() < 1e-4


@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("window", [2, 4])
def test_the_moments_of_a_window_are_those_of_a_loop_over_its_returns(level, window):
    rng = np.random.default_rng(1)
    mask = (rng.random(SIZE) < 0.05).astype(np.float32)
    inverse = rng.uniform(1, 50, SIZE).astype(np.float32) * mask
    pixels = torch.from_numpy(np.stack([mask, inverse]))[None]
    moments = planes.cell_moments(pixels, CELL)
    for _ in range(level):
        moments = planes.coarser_moments(moments)
    side = CELL * 2**level
    row, column = 1, 3
    found = planes.window_moments(moments, window)[0, :, row, column].numpy()
    expected = np.zeros(9)
    for v, u in np.argwhere(mask):
        down = 1 - abs(v // side - row) / window
        right = 1 - abs(u // side - column) / window
        if down > 0 and right > 0:
            place = np.array([[(v + 0.5) / side - row - 0.5, (u + 0.5) / side - column - 0.5]])
            expected += moments_of(place, inverse[v, u : u + 1], down * right)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_moments_of_finer_cells_are_those_of_the_four_closest_around_their_centre():
    rng = np.random.default_rng(3)
    shape = (3, 3)
    places, values = rng.uniform(-0.5, 0.5, (*shape, 6, 2)), rng.uniform(1, 9, (*shape, 6))
    cells = np.stack(
        [
            [moments_of(places[row, column], values[row, column]) for column in range(3)]
            for row in range(3)
        ]
    )
    found = planes.finer_moments(torch.from_numpy(cells).permute(2, 0, 1)[None])[0]
    assert found.shape == (9, 6, 6)
    expected = np.zeros(9)
    for (row, down), (column, right) in itertools.product(
        ((1, 0.75), (0, 0.25)), ((1, 0.75), (2, 0.25))
    ):
        # The finer cell 2, 3 is the upper right of cell 1, 1; its side is 1.
        place = 2 * (places[row, column] + (row, column)) - (2 - 0.5, 3 - 0.5)
        expected += moments_of(place, values[row, column], down * right)
    expected *= planes.LARGER_WINDOW_WEIGHT
    np.testing.assert_allclose(found[:, 2, 3], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("count", [3, 40])
def test_a_plane_is_solved_by_ridge_regression_towards_no_slope(count):
    rng = np.random.default_rng(2)
    place, values = rng.uniform(-1, 1, (count, 2)), rng.uniform(1, 9, count)
    system = np.concatenate([np.insert(place, 0, 1, axis=1), np.zeros((2, 3))])
    system[-2:, 1:] = np.sqrt(planes.FLAT_WEIGHT) * np.eye(2)
    expected = np.linalg.lstsq(system, np.append(values, [0, 0]), rcond=None)[0]
    moments = torch.from_numpy(moments_of(place, values)).view(1, 9, 1, 1)
    everywhere = torch.ones(1, 2, 1, 1, dtype=torch.float64)
    assert planes.solve_planes(moments, everywhere).item() == pytest.approx(expected[0], rel=1e-6)
    # Without slopes it is the mean.
    assert planes.solve_planes(moments, 0 * everywhere).item() == pytest.approx(values.mean())
