"""Candidates of the depth, on grids small enough to count by hand."""

import numpy as np
import pytest
import torch

from models.planes import CELL
from models.surfaces import (
    DILATION_WINDOWS,
    MAX_BASE_WEIGHT,
    MIN_DEPTH,
    OUTLIER_M,
    OUTLIER_RATIO,
    RETURN_RADIUS,
    SAME_SURFACE,
    compare_with_base,
    count_returns,
    dilate_returns,
    limit_monocular,
    propagate_surfaces,
    remove_outliers,
    surface_features,
    zero_if_same_surface,
)
from small_returns import (
    CELL_OF_TWO,
    RANGE_M,
    SIZE,
    TWO,
    grid_of,
    random_depth,
    returns_at,
    scan_lines,
    sparse_of,
)


@pytest.mark.parametrize(
    ("lines", "around", "returns", "range_m", "dropped"),
    [
        (5, 0.2, {(63, 81): 0.03}, RANGE_M, 1),
        (5, 0.2, {(63, 81): 0.99 * OUTLIER_M / RANGE_M}, RANGE_M, 1),
        (5, 0.2, {(63, 81): 1.01 * OUTLIER_M / RANGE_M}, RANGE_M, 0),  # far: a small object
        (5, 0.1, {(63, 81): 0.1 / (1.01 * OUTLIER_RATIO)}, RANGE_M, 1),
        (5, 0.1, {(63, 81): 0.1 / (0.99 * OUTLIER_RATIO)}, RANGE_M, 0),  # not much nearer
        (5, 0.2, {(63, 81): 0.3}, RANGE_M, 0),  # behind
        (5, 0.2, {(60, 80): 0.03, (65, 80): 0.03}, RANGE_M, 0),  # a pole in two scan lines
        (12, 0.2, {(58, 81): 0.03}, RANGE_M, 1),  # ten cells of two lines
        (20, 0.2, {(60, 80): 0.03}, RANGE_M, 0),  # five cells of a line confirm nothing
        (5, 0.2, {(63, 81): 0.04}, 160.0, 1),  # 6.4 m
        (5, 0.2, {(63, 81): 0.04}, 320.0, 0),  # 12.8 m
    ],
)
def test_a_near_return_that_no_other_confirms_is_dropped(lines, around, returns, range_m, dropped):
    depth = scan_lines(lines, around).depth
    for place, value in returns.items():
        depth[(0, 0, *place)] = value
    found = remove_outliers(depth, (depth > 0).float(), max_depth_m=range_m)
    expected = depth.clone()
    for place in list(returns)[:dropped]:
        expected[(0, 0, *place)] = 0
    for one, other in zip(found, sparse_of(expected), strict=True):
        assert torch.equal(one, other)


def test_two_surfaces_in_one_cell_are_kept_apart():
    """5 m and 80 m: the mean of depths, 42.5 m, is a surface that is nowhere."""
    found, fit = propagate_surfaces(returns_at(TWO))
    assert found.nearest[CELL_OF_TWO] == pytest.approx(0.05, rel=1e-4)
    assert found.farthest[CELL_OF_TWO] == pytest.approx(0.8, rel=1e-4)
    # Between two returns of inverse depth 20 and 1.25.
    assert found.inverse_plane[CELL_OF_TWO] == pytest.approx(10.625, rel=0.05)
    assert count_returns(fit)[CELL_OF_TWO] == 2


def test_a_surface_is_propagated_as_far_as_the_windows_reach_and_no_further():
    found, _ = propagate_surfaces(returns_at({(64, 96): 0.3}))
    reach = sum(window // 2 for window in DILATION_WINDOWS)
    row, columns = found.support[0, 0, 16], found.nearest[0, 0, 16]
    assert torch.nonzero(row).flatten()[[0, -1]].tolist() == [24 - reach, 24 + reach]
    assert torch.allclose(columns[row > 0], torch.tensor(0.3))


def test_the_nearest_surface_is_the_nearest_of_a_plain_loop_before_smoothing():
    maps = random_depth(0, 0.1)
    found, _ = propagate_surfaces(sparse_of(maps[None, None]))
    depth, side = maps.numpy(), CELL
    for row, column in ((5, 7), (20, 33), (25, 40)):
        cells = []
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                cell = depth[side * r : side * (r + 1), side * c : side * (c + 1)]
                if not cell.any():  # filled from the 3 x 3 cells around it
                    cell = depth[side * (r - 1) : side * (r + 2), side * (c - 1) : side * (c + 2)]
                cells.append(1 / cell[cell > 0].min())
        assert found.nearest[0, 0, row, column] == pytest.approx(1 / np.mean(cells), rel=1e-4)


def test_without_returns_there_is_no_candidate_and_no_limit():
    surfaces, fit = propagate_surfaces(returns_at({}))
    count = count_returns(fit)
    assert not surface_features(surfaces, count).any()
    assert not compare_with_base(surfaces, fit).base_weight.any()
    assert torch.equal(limit_monocular(surfaces, count), grid_of(1.0))


def test_features_lie_in_0_1():
    returns = returns_at({(0, 0): MIN_DEPTH / 10, (10, 90): 1.0, (50, 50): 0.2})
    surfaces, fit = propagate_surfaces(returns)
    features = surface_features(surfaces, count_returns(fit))
    assert -1e-6 <= features.min() <= features.max() <= 1 + 1e-6


def test_what_returns_nothing_is_no_farther_than_the_returns_around():
    surfaces, fit = propagate_surfaces(returns_at({(40, 40): 0.1, (40, 60): 0.4, (72, 40): 0.2}))
    limit = limit_monocular(surfaces, count_returns(fit))[0, 0]
    assert limit[14, 11] == pytest.approx(0.4), "below two returns: the farther one"
    assert limit[19, 10] == pytest.approx(0.2), "below a return"
    assert limit[8, 10] == 1, "above the uppermost return is outside the field of view"
    assert limit[10, 30] == 1, "so is what is beside the returns"


def test_the_base_has_weight_within_a_few_pixels_of_a_return():
    weight = compare_with_base(*propagate_surfaces(returns_at({(41, 41): 0.3}))).base_weight[0, 0]
    # The return is in cell 20 of two pixels: cells 19 to 21 count in full, 18 and 22 by half.
    expected = MAX_BASE_WEIGHT * torch.tensor([0.0, 0.75, 1.0, 0.25, 0.0, 0.0])
    assert torch.allclose(weight[10, 8:14], expected)
    assert not weight[10, 13:].any()


def test_surfaces_are_compared_with_the_base():
    surfaces, fit = propagate_surfaces(returns_at({(40, 40): 0.1, (41, 41): 0.8}))
    ratios, cell = compare_with_base(surfaces, fit), CELL_OF_TWO
    inverse = fit.inverse_base[0, 0, 20:22, 20:22].mean()
    assert ratios.nearest[cell] == pytest.approx((surfaces.nearest[cell] * inverse).log().item())
    assert ratios.farthest[cell] == pytest.approx((surfaces.farthest[cell] * inverse).log().item())
    assert ratios.nearest[cell] < -SAME_SURFACE < SAME_SURFACE < ratios.farthest[cell]


def test_one_surface_has_no_ratio():
    ratios = torch.tensor([-2.0, -1.5, -0.9, 0.0, 1.0, 1.5, 2.0, 9.0]) * SAME_SURFACE
    weights = torch.tensor([1.0, 0.5, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0])
    assert torch.allclose(zero_if_same_surface(ratios), ratios * weights, atol=1e-6)


def test_the_nearest_return_is_that_of_a_plain_loop():
    depth = random_depth(1, 0.03)
    found = dilate_returns(sparse_of(depth[None, None]))
    inverse, mask, at_pixel = (values[0, 0].numpy() for values in found)
    depth = depth.numpy()
    assert np.array_equal(at_pixel > 0, depth > 0)
    for row in range(0, SIZE[0], 3):
        for column in range(0, SIZE[1], 3):
            expected = 0.0
            for radius in range(RETURN_RADIUS + 1):  # the smallest square with a return in it
                rows = slice(max(0, row - radius), row + radius + 1)
                square = depth[rows, max(0, column - radius) : column + radius + 1]
                if square.any():
                    expected = square[square > 0].min()
                    break
            assert mask[row, column] == (expected > 0)
            assert inverse[row, column] == pytest.approx(1 / (expected or 1.0), rel=1e-5)
