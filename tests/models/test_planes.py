"""Planes between returns: exact on planes, and against sums and fits written out in loops."""

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from models import planes
from models.planes import fit_planes

SIZE = (128, 192)
CELL, LEVELS = 4, 3


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


def fit(inverse, mask):
    """In the cells, and the share of returns; inverse: 0 where nothing is measured."""
    depth = mask / inverse.clamp(min=1)
    extremes = F.max_pool2d(torch.cat([inverse, depth], dim=1), CELL)
    return fit_planes(inverse, mask, extremes, cell=CELL, levels=LEVELS)


def fitted(inverse, mask):
    """At the pixels, and the share of returns."""
    plane, share = fit(inverse * mask, mask)
    return F.interpolate(plane, scale_factor=4.0, mode="bilinear"), share


@pytest.mark.parametrize("pattern", ["lines", "tilted lines", "at random", "with a gap"])
def test_a_plane_is_exact_between_its_returns_whatever_their_pattern(pattern):
    mask = mask_of(pattern)
    found, share = fitted(road(), mask)
    assert share.sum() * CELL**2 == pytest.approx(mask.sum().item())
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
    returns = inverse[mask > 0]
    assert returns.min() <= found.min() <= found.max() <= returns.max()


def test_beyond_the_returns_a_slope_is_not_continued():
    """The road goes up to the horizon; above the scan there are houses."""
    mask = mask_of("lines")
    mask[..., :64, :] = 0
    found, _ = fitted(road(), mask)
    lowest = road()[..., 83, :].mean().item()
    assert (found[..., :16, :] > 0.8 * lowest).all()


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
    both, _ = fit(torch.cat([road() * first, 2 * road() * second]), torch.cat([first, second]))
    alone, _ = fit(2 * road() * second, second)
    assert torch.allclose(both[1:], alone, rtol=1e-5)


def test_reduced_precision_around_it_does_not_reach_the_sums():
    mask = mask_of("lines")
    expected, _ = fitted(road(), mask)
    with torch.autocast("cpu", torch.bfloat16):
        found, _ = fitted(road(), mask)
    assert torch.equal(found, expected)


@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("window", [2, 4])
def test_the_sums_of_a_window_are_those_of_a_loop_over_its_returns(level, window):
    rng = np.random.default_rng(1)
    mask = (rng.random(SIZE) < 0.05).astype(np.float32)
    inverse = rng.uniform(1, 50, SIZE).astype(np.float32) * mask
    pixels = torch.from_numpy(np.stack([mask, inverse]))[None]
    sums = planes._convolve(pixels, planes._cell_kernel(CELL), stride=CELL)
    for _ in range(level):
        sums = planes._convolve(sums, planes._coarser_kernel(), stride=2)
    side = CELL * 2**level
    row, column = 1, 3
    found = planes._sums_around(sums, window)[0, :, row, column].numpy()
    expected = np.zeros(9)
    for v, u in np.argwhere(mask):
        down = 1 - abs(v // side - row) / window
        right = 1 - abs(u // side - column) / window
        if down > 0 and right > 0:
            r, c = (v + 0.5) / side - row - 0.5, (u + 0.5) / side - column - 0.5
            powers = np.array([1, r, c, r * r, c * c, r * c])
            weighed = inverse[v, u] * powers[:3]
            expected += down * right * np.concatenate([powers, weighed])
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_a_fit_is_the_ridge_regression_towards_the_prior():
    """In the middle of its returns, where nothing limits the slopes."""
    rng = np.random.default_rng(2)
    place = rng.uniform(-1, 1, (40, 2))
    place -= place.mean(axis=0)
    values, prior = rng.uniform(1, 9, 40), np.array([3.0, 0.5, -0.2])
    r, c = place.T
    powers = np.stack([np.ones(40), r, c, r * r, c * c, r * c])
    sums = np.concatenate([powers.sum(axis=1), (powers[:3] * values).sum(axis=1)])
    weights = np.sqrt([planes.VALUE_WEIGHT, planes.SLOPE_WEIGHT, planes.SLOPE_WEIGHT])
    system = np.concatenate([powers[:3].T, np.diag(weights)])
    expected = np.linalg.lstsq(system, np.concatenate([values, weights * prior]), rcond=None)[0]
    found = planes._fit(
        torch.from_numpy(sums).view(1, 9, 1, 1), torch.from_numpy(prior).view(1, 3, 1, 1)
    )
    np.testing.assert_allclose(found.flatten(), expected, rtol=1e-6)
