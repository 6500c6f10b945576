"""Candidate surfaces and the choice among them, on grids small enough to count by hand."""

import numpy as np
import pytest
import torch

from models.blocks import upsample
from models.planes import BASE_CELL, CELL
from models.surface_depth import (
    DEAD_ZONE,
    LOG_SCALE,
    MAX_SCALE_REDUCTION,
    PARALLAX,
    SLOPE,
    SPREAD_SHARE,
    STRETCH,
    HeadChannels,
    choose_surface,
    confidence,
    correction_room,
    depart,
    join_base,
    position,
    take_returns,
)
from models.surfaces import (
    APART,
    ISOLATED_M,
    ISOLATED_RATIO,
    MOST_BESIDE,
    NEAREST,
    RETURN_REACH,
    WINDOWS,
    Measured,
    apart,
    dilate_returns,
    limit_guess,
    look_beside,
    measure,
    propagate_surfaces,
    surface_features,
)

SIZE, GRID = (128, 192), (32, 48)
RANGE_M = 200.0
# Logits of the head in their order, and those that leave the guess as it is.
NO_CHOICE = {"plane": -30.0, "farthest": -30.0, "nearest": -30.0}
CHANNELS = (*NO_CHOICE, "correction", "scale", "before", "behind", "reduction")


def measured_where(depth):
    """Return the returns of a depth map, including isolated ones."""
    mask = (depth > 0).float()
    return Measured(depth, mask, mask / depth.clamp(min=NEAREST))


def measured(returns=None):
    """Returns at (row, column) of a normalised depth."""
    depth = torch.zeros(1, 1, *SIZE)
    for place, value in (returns or {}).items():
        depth[(0, 0, *place)] = value
    return measured_where(depth)


def scanned(lines, value=0.2):
    """A depth at every second column of every `lines`-th row."""
    depth = torch.zeros(1, 1, *SIZE)
    depth[..., ::lines, ::2] = value
    return depth


def road():
    """The inverse depth of a tilted plane at every pixel, and its returns in some lines."""
    rows = torch.arange(SIZE[0]).float().view(1, 1, -1, 1).expand(1, 1, *SIZE)
    inverse, mask = 2 + 0.1 * rows, (scanned(8) > 0).float()
    return inverse, Measured(mask / inverse, mask, mask * inverse)


def random_depth(seed, share):
    rng = np.random.default_rng(seed)
    taken = torch.from_numpy(rng.random(SIZE) < share)
    return torch.from_numpy(rng.uniform(0.02, 0.9, SIZE).astype(np.float32)) * taken


def head_of(**logits):
    """Logits of the named channels; the others leave the guess as it is."""
    values = [(NO_CHOICE | logits).get(name, 0.0) for name in CHANNELS]
    return HeadChannels.split(torch.tensor(values).view(1, -1, 1, 1).expand(1, -1, *GRID))


def grid_of(value):
    return torch.full((1, 1, *GRID), value)


TWO = {(40, 40): 0.05, (41, 41): 0.8}
# The cell of these two.
CELL_OF_TWO = (0, 0, 10, 10)


@pytest.mark.parametrize(
    ("lines", "around", "returns", "range_m", "dropped"),
    [
        (5, 0.2, {(63, 81): 0.03}, RANGE_M, 1),
        (5, 0.2, {(63, 81): 0.99 * ISOLATED_M / RANGE_M}, RANGE_M, 1),
        (5, 0.2, {(63, 81): 1.01 * ISOLATED_M / RANGE_M}, RANGE_M, 0),  # far: a small object
        (5, 0.1, {(63, 81): 0.1 / (1.01 * ISOLATED_RATIO)}, RANGE_M, 1),
        (5, 0.1, {(63, 81): 0.1 / (0.99 * ISOLATED_RATIO)}, RANGE_M, 0),  # not much nearer
        (5, 0.2, {(63, 81): 0.3}, RANGE_M, 0),  # behind
        (5, 0.2, {(60, 80): 0.03, (65, 80): 0.03}, RANGE_M, 0),  # a pole in two scan lines
        (20, 0.2, {(60, 80): 0.03}, RANGE_M, 0),  # five cells of a line confirm nothing
        (5, 0.2, {(63, 81): 0.04}, 160.0, 1),  # 6.4 m
        (5, 0.2, {(63, 81): 0.04}, 320.0, 0),  # 12.8 m
    ],
)
def test_a_near_return_that_no_other_confirms_is_dropped(lines, around, returns, range_m, dropped):
    depth = scanned(lines, around)
    for place, value in returns.items():
        depth[(0, 0, *place)] = value
    found = measure(depth, (depth > 0).float(), max_depth_m=range_m)
    expected = depth.clone()
    for place in list(returns)[:dropped]:
        expected[(0, 0, *place)] = 0
    for one, other in zip(found, measured_where(expected), strict=True):
        assert torch.equal(one, other)


def test_two_surfaces_in_one_cell_are_kept_apart():
    """5 m and 80 m: the mean of depths, 42.5 m, is a surface that is nowhere."""
    found, _, count = propagate_surfaces(measured(TWO))
    assert found.nearest[CELL_OF_TWO] == pytest.approx(0.05, rel=1e-4)
    assert found.farthest[CELL_OF_TWO] == pytest.approx(0.8, rel=1e-4)
    # Between two returns of inverse depth 20 and 1.25.
    assert found.plane[CELL_OF_TWO] == pytest.approx(10.625, rel=0.05)
    assert count[CELL_OF_TWO] == 2


def test_a_surface_is_propagated_as_far_as_the_windows_reach_and_no_further():
    found, *_ = propagate_surfaces(measured({(64, 96): 0.3}))
    reach = sum(window // 2 for window in WINDOWS)
    row, columns = found.support[0, 0, 16], found.nearest[0, 0, 16]
    assert torch.nonzero(row).flatten()[[0, -1]].tolist() == [24 - reach, 24 + reach]
    assert torch.allclose(columns[row > 0], torch.tensor(0.3))


def test_the_nearest_surface_is_the_nearest_of_a_plain_loop_before_smoothing():
    maps = random_depth(0, 0.1)
    found, *_ = propagate_surfaces(measured_where(maps[None, None]))
    depth, side = maps.numpy(), CELL
    for row, column in ((5, 7), (20, 33), (25, 40)):
        cells = []
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                cell = depth[side * r : side * (r + 1), side * c : side * (c + 1)]
                if not cell.any():  # filled from the 3 x 3 cells around it
                    cell = depth[side * (r - 1) : side * (r + 2), side * (c - 1) : side * (c + 2)]
                cells.append(1 / cell[cell > 0].min())
        expected = 1 / np.mean(cells)
        assert found.nearest[0, 0, row, column] == pytest.approx(expected, rel=1e-4)


def chosen_of(head, guess, surfaces, base, *, reach=1.0):
    """The depth that is chosen, and the scale of its error."""
    room = correction_room(look_beside(surfaces, base), surfaces.support)
    inverse, scale = choose_surface(head, grid_of(guess), surfaces, room, reach=reach)
    return 1 / inverse, scale


def test_nothing_measured_changes_nothing():
    nothing = measured()
    found, base, count = propagate_surfaces(nothing)
    assert not surface_features(found, count).any()
    assert not look_beside(found, base).share.any()
    assert torch.equal(limit_guess(found, count), grid_of(1.0))
    confident = head_of(plane=30.0, farthest=30.0, nearest=30.0)
    depth, scale = chosen_of(confident, 0.4, found, base)
    assert torch.allclose(depth, grid_of(0.4))
    assert torch.equal(scale, chosen_of(head_of(), 0.4, found, base)[1])
    taken, kept = taken_of(1.0, 1.0, reduction=1.0)
    assert (taken == 0.5).all()
    assert (kept == 0.04).all()


def test_features_lie_in_0_1():
    surfaces, _, count = propagate_surfaces(
        measured({(0, 0): NEAREST / 10, (10, 90): 1.0, (50, 50): 0.2})
    )
    features = surface_features(surfaces, count)
    assert -1e-6 <= features.min() <= features.max() <= 1 + 1e-6


def test_what_returns_nothing_is_no_farther_than_the_returns_around():
    surfaces, _, count = propagate_surfaces(measured({(40, 40): 0.1, (40, 60): 0.4, (72, 40): 0.2}))
    limit = limit_guess(surfaces, count)[0, 0]
    assert limit[14, 11] == pytest.approx(0.4), "below two returns: the farther one"
    assert limit[19, 10] == pytest.approx(0.2), "below a return"
    assert limit[8, 10] == 1, "over the uppermost return the LiDAR did not look"
    assert limit[10, 30] == 1, "beside the returns neither"


@pytest.mark.parametrize(
    ("returns", "logits", "guess", "expected"),
    [
        (TWO, {"farthest": 30.0}, 0.4, 0.8),
        (TWO, {"nearest": 30.0}, 0.4, 0.05),
        (TWO, {"farthest": 30.0, "correction": 30.0}, 0.4, 1.0),
        (TWO, {"nearest": 30.0, "correction": 30.0}, 0.4, 0.05 * np.exp(0.5)),
        # Where both surfaces agree there is no room for a correction.
        (scanned(8), {"plane": -30.0, "correction": 30.0}, 0.45, 0.45),
        (scanned(8), {"plane": 0.0, "correction": 30.0}, 0.45, (0.2 + 0.45) / 2),
        (scanned(8), {"plane": 30.0, "correction": 30.0}, 0.45, 0.2),
    ],
)
def test_a_candidate_replaces_the_others_by_the_confidence_in_it(returns, logits, guess, expected):
    found, base, _ = propagate_surfaces(
        measured(returns) if isinstance(returns, dict) else measured_where(returns)
    )
    depth, _ = chosen_of(head_of(**logits), guess, found, base)
    assert depth[CELL_OF_TWO] == pytest.approx(expected, rel=1e-3)


def test_a_correction_stays_between_both_surfaces():
    found, base, _ = propagate_surfaces(measured_where(scanned(8, 0.3)))
    found = found._replace(farthest=grid_of(0.36))
    corrected, _ = chosen_of(head_of(plane=30.0, correction=30.0), 0.45, found, base)
    assert torch.allclose(corrected, torch.tensor(0.36), rtol=1e-3)


def test_beyond_the_reach_of_the_guess_only_returns_are_answered():
    found, base, _ = propagate_surfaces(measured(TWO))
    for logits, cell, expected in (
        ({}, (0, 0, 30, 40), 0.5),
        ({"farthest": 30.0}, CELL_OF_TWO, 0.8),
    ):
        head = head_of(correction=30.0, **logits)
        chosen, _ = chosen_of(head, 0.45, found, base, reach=0.5)
        assert chosen[cell] == pytest.approx(expected, rel=1e-4)


def test_a_plane_is_the_answer_of_a_head_without_confidence_in_surfaces():
    inverse, returns = road()
    found, base, _ = propagate_surfaces(returns)
    chosen = 1 / chosen_of(head_of(plane=30.0), 0.45, found, base)[0]
    expected = torch.nn.functional.avg_pool2d(inverse, CELL)
    assert torch.allclose(chosen[..., 3:-3, :], expected[..., 3:-3, :], rtol=1e-3)


def test_a_confidence_reaches_0_and_1_and_can_be_trained_back():
    logits = torch.tensor([-9.0, -2.5, -2.3, 0.0, 2.3, 2.5, 9.0], requires_grad=True)
    found = confidence(logits)
    assert torch.allclose(found[[0, 1, 3, 5, 6]], torch.tensor([0, 0, 0.5, 1, 1]))
    assert 0 < found[2] < 0.02 < 0.98 < found[4] < 1
    found.sum().backward()
    share = torch.sigmoid(logits.detach())
    assert torch.allclose(logits.grad, (1 + 2 * STRETCH) * share * (1 - share))
    with torch.no_grad():
        assert torch.allclose(confidence(logits), found)


def test_a_position_has_a_dead_zone_and_can_be_trained_out_of_it():
    x = torch.tensor([-9.0, -1.0, -0.05, 0.05, 0.6, 1.05, 9.0], requires_grad=True)
    found = position(x)
    expected = torch.tensor([-1.0, DEAD_ZONE - 1.0, 0.0, 0.0, 0.6 - DEAD_ZONE, 0.95, 1.0])
    assert torch.allclose(found, expected, atol=1e-6)
    found.sum().backward()
    assert torch.equal(x.grad, torch.ones(7))
    with torch.no_grad():
        assert torch.allclose(position(x), expected, atol=1e-6)


def test_beside_is_what_lies_within_a_few_pixels_of_a_return():
    surfaces, base, _ = propagate_surfaces(measured({(41, 41): 0.3}))
    share = look_beside(surfaces, base).share[0, 0]
    # The return is in cell 20 of two pixels: cells 19 to 21 count in full, 18 and 22 by half.
    expected = MOST_BESIDE * torch.tensor([0.0, 0.75, 1.0, 0.25, 0.0, 0.0])
    assert torch.allclose(share[10, 8:14], expected)
    assert not share[10, 13:].any()


def test_surfaces_are_compared_with_the_base():
    surfaces, base, _ = propagate_surfaces(measured({(40, 40): 0.1, (41, 41): 0.8}))
    beside, at = look_beside(surfaces, base), CELL_OF_TWO
    inverse = base.base[0, 0, 20:22, 20:22].mean()
    assert beside.near[at] == pytest.approx((surfaces.nearest[at] * inverse).log().item())
    assert beside.far[at] == pytest.approx((surfaces.farthest[at] * inverse).log().item())
    assert beside.near[at] < -APART < APART < beside.far[at]
    ratios = torch.tensor([-2.0, -1.5, -0.9, 0.0, 1.0, 1.5, 2.0, 9.0]) * APART
    weights = torch.tensor([1.0, 0.5, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0])
    assert torch.allclose(apart(ratios), ratios * weights, atol=1e-6)


@pytest.mark.parametrize("place", [0.0, 0.9 * DEAD_ZONE, -0.9 * DEAD_ZONE])
def test_at_full_share_the_answer_is_the_base_with_its_detail(place):
    inverse, returns = road()
    surfaces, base, _ = propagate_surfaces(returns)
    ratios = torch.cat(look_beside(surfaces, base)[:2], dim=1)
    departure = upsample(depart(position(grid_of(place)), apart(ratios)))
    chosen, whole = torch.full_like(base.base, 2.0), torch.ones_like(base.base)
    found, _ = join_base(chosen, 0.1 / chosen, base.base, departure, whole, whole)
    inside = (..., slice(12, -12), slice(12, -12))
    assert torch.allclose(upsample(found, factor=BASE_CELL)[inside], inverse[inside], rtol=1e-3)


@pytest.mark.parametrize(
    ("place", "near", "far", "log_ratio"),
    [
        (-1.2, -1.0, 0.5, -1.0),
        (1.2, -1.0, 0.5, 0.5),
        (0.5 + DEAD_ZONE, -1.0, 0.5, 0.25),
        (-0.5 - DEAD_ZONE, -1.0, 0.5, -0.5),
        (1.2, -1.0, 0.9 * APART, 0.0),  # one surface
        (-1.2, -0.9 * APART, 0.5, 0.0),
    ],
)
def test_a_departure_is_to_a_surface_and_only_where_there_are_two(place, near, far, log_ratio):
    departures = apart(torch.cat([grid_of(near), grid_of(far)], dim=1))
    departure = depart(position(grid_of(place)), departures)
    assert torch.allclose(departure, torch.tensor(log_ratio), atol=1e-5)
    base, whole = torch.full_like(departure, 4.0), torch.ones_like(departure)
    inverse, _ = join_base(base / 2, 1 / base, base, departure, whole, whole)
    assert torch.allclose(-(inverse / base).log(), departure, atol=1e-5)


def test_the_image_keeps_its_share_beside_returns_and_all_of_it_farther():
    surfaces, base, _ = propagate_surfaces(measured_where(scanned(8, 0.25)))
    beside = look_beside(surfaces, base)
    chosen = torch.full_like(base.base, 2.0)
    still, share = torch.zeros_like(chosen), upsample(beside.share)
    relative = float(np.exp(sum(LOG_SCALE) / 2))
    maps = base.base, still, torch.full_like(chosen, relative)
    inverse, scale = join_base(chosen, 0.1 / chosen, *maps, share)
    assert 0.9 * MOST_BESIDE < share.max() <= MOST_BESIDE
    inside = (..., slice(12, -12), slice(12, -12))
    assert torch.allclose(inverse[inside], (2.0 + 2.0 * share)[inside], rtol=1e-3)
    expected = 0.05 + share * (relative / inverse - 0.05)
    assert torch.allclose(scale[inside], expected[inside], rtol=1e-3)
    assert torch.equal(join_base(chosen, 0.1 / chosen, *maps, still)[0], chosen)


@pytest.mark.parametrize(("logit", "log"), [(-99, LOG_SCALE[0]), (0, -2.5), (99, LOG_SCALE[1])])
def test_the_error_is_a_bounded_share_of_the_depth(logit, log):
    """The depth is half of 0.8 and half of 0.4, then half of 0.05 and half of that result."""
    halves = head_of(farthest=0.0, nearest=0.0, scale=logit)
    for returns, expected in (({}, 0.4), (TWO, 0.325)):
        found, base, _ = propagate_surfaces(measured(returns))
        maps = chosen_of(halves, 0.4, found._replace(plane=grid_of(2.5)), base)
        depth, scale = (each[CELL_OF_TWO] for each in maps)
        assert depth == pytest.approx(expected, rel=1e-3)
        assert scale == pytest.approx(expected * np.exp(log), rel=1e-3)


def test_the_scale_does_not_train_the_choice():
    own = grid_of(0.4).requires_grad_()
    head = torch.cat(head_of(plane=0.0, farthest=0.0, nearest=0.0), dim=1).requires_grad_()
    found, base, _ = propagate_surfaces(measured(TWO))
    room = correction_room(look_beside(found, base), found.support)
    choose_surface(HeadChannels.split(head), own, found, room, reach=1.0)[1].sum().backward()
    trained = head.grad.abs().sum(dim=(0, 2, 3)) > 0
    assert [name for name, is_trained in zip(CHANNELS, trained, strict=True) if is_trained] == [
        "scale"
    ]
    assert own.grad is None or not own.grad.any()


def test_the_nearest_return_is_that_of_a_plain_loop():
    maps = random_depth(1, 0.03)
    inverse, near, here = (
        found[0, 0].numpy() for found in dilate_returns(measured_where(maps[None, None]))
    )
    depth = maps.numpy()
    assert np.array_equal(here > 0, depth > 0)
    for row in range(0, SIZE[0], 3):
        for column in range(0, SIZE[1], 3):
            expected = 0.0
            for reach in range(RETURN_REACH + 1):  # the smallest square with a return in it
                rows = slice(max(0, row - reach), row + reach + 1)
                square = depth[rows, max(0, column - reach) : column + reach + 1]
                if square.any():
                    expected = square[square > 0].min()
                    break
            assert near[row, column] == (expected > 0)
            assert inverse[row, column] == pytest.approx(1 / (expected or 1.0), rel=1e-5)


def taken_of(before, behind, depth=0.5, reduction=0.0, returns=None, range_m=RANGE_M):
    """Return the depth and the scale, which was 0.04, after returns were taken."""
    confidence = torch.tensor([before, behind, reduction]).view(1, 3, 1, 1).expand(1, 3, *SIZE)
    maps = (torch.full((1, 1, *SIZE), value) for value in (1 / depth, 0.04))
    found = take_returns(*maps, dilate_returns(measured(returns)), confidence, max_depth_m=range_m)
    return found[0][0, 0], found[1][0, 0]


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
@pytest.mark.parametrize(("returned", "channel"), [(0.05, 0), (0.9, 1)])
def test_a_return_is_taken_by_its_confidence_beside_it_and_nowhere_else(returned, channel, share):
    """Returns before and behind the predicted depth have a channel of confidence each."""
    confidence = [0.0, 0.0]
    confidence[channel] = share
    depth, scale = taken_of(*confidence, reduction=0.4, returns={(40, 40): returned})
    square = np.s_[38:43, 38:43]
    assert torch.allclose(depth[square], torch.tensor(0.5 + share * (returned - 0.5)))
    spread = share * (1 - share) * abs(returned - 0.5)
    reduced = 0.04 * (1 - 0.4 * MAX_SCALE_REDUCTION)
    assert torch.allclose(scale[square], torch.tensor(reduced + SPREAD_SHARE * spread))
    depth[square], scale[square] = 0.5, 0.04
    assert (depth == 0.5).all()
    assert (scale == 0.04).all()


@pytest.mark.parametrize(
    ("share", "weight"), [(-0.9, 1.0), (-1.5, 0.5), (-2.1, 0.0), (0.9, 1.0), (1.5, 0.5), (2.1, 0.0)]
)
def test_a_return_at_the_pixel_without_parallax_is_taken_without_confidence(share, weight):
    """share: of PARALLAX, between the return and the predicted depth."""
    returned = 1 / (1 / 0.5 - share * RANGE_M * PARALLAX)
    depth, _ = taken_of(0.0, 0.0, returns={(50, 20): returned})
    assert depth[50, 20] == pytest.approx(0.5 + weight * (returned - 0.5), rel=1e-4)
    if share < 0:  # beside it one before the predicted depth needs confidence
        assert depth[50, 21] == 0.5


@pytest.mark.parametrize(
    ("depth", "step", "range_m", "weight"),
    [
        (0.4, 2.1 * SLOPE, RANGE_M, 1.0),
        (0.4, 1.5 * SLOPE, RANGE_M, 0.5),
        (0.4, 0.9 * SLOPE, RANGE_M, 0.0),  # a slope, which is predicted better than copied
        (0.05, 2.1 * SLOPE, RANGE_M, 0.0),  # 10 m: past a surface as near a LiDAR sees
        (0.4, 0.1, RANGE_M, 1.0),  # of 80 m
        (0.4, 0.1, 50.0, 0.0),  # of 20 m
        (0.4, -2.1 * SLOPE, RANGE_M, 0.0),  # before it
    ],
)
def test_beside_a_return_one_behind_without_parallax_is_taken(depth, step, range_m, weight):
    returned = depth * (1 + step)
    found, _ = taken_of(0.0, 0.0, depth, returns={(40, 40): returned}, range_m=range_m)
    for row, column in ((38, 38), (40, 42), (39, 41)):
        assert found[row, column] == pytest.approx(depth + weight * (returned - depth), rel=1e-4)
    assert found[40, 43] == pytest.approx(depth)
