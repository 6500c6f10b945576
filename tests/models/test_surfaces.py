"""Candidate surfaces and the choice among them, on grids small enough to count by hand."""

import numpy as np
import pytest
import torch

from models.blocks import upsample
from models.planes import BASE_CELL, CELL, Base
from models.surfaces import (
    APART,
    DEAD_ZONE,
    HEAD_CHANNELS,
    ISOLATED_CELLS,
    ISOLATED_M,
    ISOLATED_RATIO,
    LOG_SCALE,
    MAX_SCALE_REDUCTION,
    MOST_BESIDE,
    NEAREST,
    PARALLAX,
    RETURN_REACH,
    SLOPE,
    SPREAD_SHARE,
    STRETCH,
    WINDOWS,
    Beside,
    HeadChannels,
    Measured,
    Surfaces,
    apart,
    choose_surface,
    confidence,
    dilate_returns,
    join_base,
    limit_guess,
    look_beside,
    measure,
    position,
    propagate_surfaces,
    replace,
    surface_features,
    take_returns,
)

SIZE = (128, 192)
GRID = (32, 48)
RANGE_M = 200.0


def measured(**returns: float) -> Measured:
    """Returns at r<row>c<column> = normalised depth."""
    depth = torch.zeros(1, 1, *SIZE)
    for place, value in returns.items():
        row, column = (int(number) for number in place[1:].split("c"))
        depth[0, 0, row, column] = value
    return measured_where(depth)


def measured_where(depth: torch.Tensor) -> Measured:
    """What a depth map holds, isolated returns too."""
    mask = (depth > 0).float()
    return Measured(depth, mask, mask / depth.clamp(min=NEAREST))


def propagated(maps: Measured) -> Surfaces:
    return propagate_surfaces(maps)[0]


def head_of(**logits: float) -> HeadChannels:
    """Logits of the named channels; the others are 0."""
    channels = (
        "plane",
        "farthest",
        "nearest",
        "correction",
        "scale",
        "before",
        "behind",
        "reduction",
    )
    assert len(channels) == HEAD_CHANNELS
    values = [logits.get(name, -30.0 if name in channels[:3] else 0.0) for name in channels]
    return HeadChannels.split(torch.tensor(values).view(1, -1, 1, 1).expand(1, -1, *GRID))


def scanned(lines: int, value: float = 0.2) -> torch.Tensor:
    """A depth at every second column of every ``lines``-th row."""
    depth = torch.zeros(1, 1, *SIZE)
    depth[..., ::lines, ::2] = value
    return depth


def kept(depth: torch.Tensor, max_depth_m: float = RANGE_M) -> torch.Tensor:
    found = measure(depth, (depth > 0).float(), max_depth_m=max_depth_m)
    mask = found.mask > 0
    left = measured_where(torch.where(mask, depth, 0.0))
    assert all(torch.equal(one, other) for one, other in zip(found, left, strict=True))
    return mask


def test_a_near_return_that_no_other_confirms_is_dropped():
    depth = scanned(5)
    depth[0, 0, 63, 81] = 0.03
    found = kept(depth)
    assert not found[0, 0, 63, 81]
    assert found.sum() == (depth > 0).sum() - 1


@pytest.mark.parametrize(
    ("around", "value", "is_kept"),
    [
        (0.2, 1.01 * ISOLATED_M / RANGE_M, True),  # far: a small thing
        (0.2, 0.99 * ISOLATED_M / RANGE_M, False),
        (0.1, 0.1 / (0.99 * ISOLATED_RATIO), True),  # hardly nearer than what is around it
        (0.1, 0.1 / (1.01 * ISOLATED_RATIO), False),
        (0.2, 0.3, True),  # behind
    ],
)
def test_only_what_is_near_and_far_before_all_others_is_dropped(around, value, is_kept):
    depth = scanned(5, around)
    depth[0, 0, 63, 81] = value
    assert bool(kept(depth)[0, 0, 63, 81]) == is_kept


@pytest.mark.parametrize(("range_m", "is_kept"), [(80.0, False), (160.0, False), (320.0, True)])
def test_near_is_counted_in_metres(range_m, is_kept):
    """0.04 of the range are 3.2, 6.4 and 12.8 m."""
    depth = scanned(5)
    depth[0, 0, 63, 81] = 0.04
    assert bool(kept(depth, range_m)[0, 0, 63, 81]) == is_kept


def test_two_returns_beside_each_other_confirm_each_other():
    """A pole in two scan lines."""
    depth = scanned(5)
    depth[0, 0, 60, 80] = depth[0, 0, 65, 80] = 0.03
    assert kept(depth).sum() == (depth > 0).sum()


def test_where_returns_are_few_a_single_one_is_kept():
    """With 16 lines a pole may have one return: its five cells of a line are no witnesses."""
    depth = scanned(20)
    depth[0, 0, 60, 80] = 0.03
    assert ISOLATED_CELLS > 5
    assert kept(depth).sum() == (depth > 0).sum()


def test_two_surfaces_in_one_cell_are_kept_apart():
    """5 m and 80 m: the mean of depths, 42.5 m, is a surface that is nowhere."""
    found, _, count = propagate_surfaces(measured(r40c40=0.05, r41c41=0.8))
    cell = (0, 0, 10, 10)
    assert found.nearest[cell].item() == pytest.approx(0.05, rel=1e-4)
    assert found.farthest[cell].item() == pytest.approx(0.8, rel=1e-4)
    # Between two returns of inverse depth 20 and 1.25.
    assert found.plane[cell].item() == pytest.approx(10.625, rel=0.05)
    assert count[cell].item() == 2


def test_a_surface_is_propagated_as_far_as_the_windows_reach_and_no_further():
    found = propagated(measured(r64c96=0.3))
    reach = sum(window // 2 for window in WINDOWS)
    row, columns = found.support[0, 0, 16], found.nearest[0, 0, 16]
    ends = [int(index) for index in torch.nonzero(row).flatten()[[0, -1]]]
    assert ends == [24 - reach, 24 + reach]
    inside = columns[row > 0]
    assert inside.min().item() == pytest.approx(0.3, rel=1e-4)
    assert inside.max().item() == pytest.approx(0.3, rel=1e-4)


def test_the_nearest_surface_is_the_nearest_of_a_plain_loop_before_smoothing():
    rng = np.random.default_rng(0)
    taken = torch.from_numpy(rng.random(SIZE) < 0.1)
    maps = torch.from_numpy(rng.uniform(0.02, 0.9, SIZE).astype(np.float32)) * taken
    found = propagated(measured_where(maps[None, None]))
    depth, side = maps.numpy(), CELL
    for row, column in ((5, 7), (20, 33), (25, 40)):
        cells = []
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                cell = depth[side * r : side * (r + 1), side * c : side * (c + 1)]
                if not cell.any():  # filled from the 3 x 3 cells around it
                    cell = depth[side * (r - 1) : side * (r + 2), side * (c - 1) : side * (c + 2)]
                assert cell.any()
                cells.append(1 / cell[cell > 0].min())
        assert found.nearest[0, 0, row, column].item() == pytest.approx(
            1 / np.mean(cells), rel=1e-4
        )


def test_nothing_measured_supports_nothing():
    found, _, count = propagate_surfaces(measured())
    assert not found.support.any()
    assert not found.reached.any()
    assert not surface_features(found, count).any()
    own = torch.full((1, 1, *GRID), 0.4)
    confident = head_of(plane=30.0, farthest=30.0, nearest=30.0)
    depth, scale = choose_surface(confident, own, found)
    assert torch.allclose(depth, own)
    assert torch.equal(scale, choose_surface(head_of(), own, found)[1])  # nothing to disagree with


@pytest.mark.parametrize("candidate", ["farthest", "nearest"])
def test_a_candidate_of_full_confidence_is_the_answer(candidate):
    found = propagated(measured(r40c40=0.05, r41c41=0.8))
    own = torch.full((1, 1, *GRID), 0.4)
    chosen = choose_surface(head_of(**{candidate: 30.0}), own, found)[0][0, 0, 10, 10]
    assert chosen.item() == pytest.approx(getattr(found, candidate)[0, 0, 10, 10].item(), rel=1e-3)
    largest = head_of(**{candidate: 30.0}, correction=30.0)
    corrected = choose_surface(largest, own, found)[0][0, 0, 10, 10]
    assert corrected.item() == pytest.approx(min(1.0, chosen.item() * np.exp(0.5)), rel=1e-3)


def test_the_guess_replaces_the_plane_by_the_confidence_that_it_lacks():
    found = propagated(measured_where(scanned(8)))
    own = torch.full((1, 1, *GRID), 0.45)
    for plane, expected in ((-30.0, 0.45), (0.0, (0.2 + 0.45) / 2), (30.0, 0.2)):
        # A correction has no room where both surfaces agree.
        chosen = choose_surface(head_of(plane=plane, correction=30.0), own, found)[0]
        assert torch.allclose(chosen[..., 8:-8, 8:-8], torch.tensor(expected), rtol=1e-3)


def test_a_confidence_reaches_0_and_1():
    found = confidence(torch.tensor([-9.0, -2.5, -2.3, 0.0, 2.3, 2.5, 9.0]))
    assert found[[0, 1, 5, 6]].tolist() == [0, 0, 1, 1]
    assert found[3] == 0.5
    assert 0 < found[2] < 0.02 < 0.98 < found[4] < 1


def test_a_closed_confidence_can_be_trained_to_open():
    logits = torch.tensor([-4.0, 4.0, 0.5], requires_grad=True)
    found = confidence(logits)
    assert torch.allclose(found[:2], torch.tensor([0.0, 1.0]))
    found.sum().backward()
    share = torch.sigmoid(logits.detach())
    assert torch.allclose(logits.grad, (1 + 2 * STRETCH) * share * (1 - share))


def test_near_returns_of_one_surface_leave_no_room_for_a_correction():
    found = propagated(measured_where(scanned(8, 0.3)))
    own = torch.full((1, 1, *GRID), 0.45)
    corrected = choose_surface(head_of(plane=30.0, correction=30.0), own, found)[0]
    assert torch.allclose(corrected, torch.tensor(0.3), rtol=1e-3)
    # Between 0.3 and 0.36 there is room for a fifth.
    two = found._replace(farthest=torch.full_like(found.farthest, 0.36))
    corrected = choose_surface(head_of(plane=30.0, correction=30.0), own, two)[0]
    assert torch.allclose(corrected, torch.tensor(0.36), rtol=1e-3)


def test_a_plane_is_the_answer_of_a_head_without_confidence_in_surfaces():
    rows = torch.arange(SIZE[0]).float().view(1, 1, -1, 1).expand(1, 1, *SIZE)
    inverse = 2 + 0.1 * rows
    mask = (scanned(8) > 0).float()
    found = propagated(Measured(mask / inverse, mask, mask * inverse))
    own = torch.full((1, 1, *GRID), 0.45)
    chosen = 1 / choose_surface(head_of(plane=30.0), own, found)[0]
    expected = 2 + 0.1 * (torch.arange(GRID[0]) * CELL + 1.5).view(1, 1, -1, 1)
    assert torch.allclose(chosen[..., 3:-3, :], expected.expand_as(chosen)[..., 3:-3, :], rtol=1e-3)


def compared(maps: Measured) -> tuple[Surfaces, Base, Beside]:
    surfaces, base, _ = propagate_surfaces(maps)
    return surfaces, base, look_beside(surfaces, base)


def test_beside_is_what_lies_within_a_few_pixels_of_a_return():
    share = compared(measured(r41c41=0.3))[2].share[0, 0]
    # The return is in cell 20 of two pixels: cells 19 to 21 count in full, 18 and 22 by half.
    expected = torch.zeros(6)
    for column, shares in ((9, (0.5, 1.0)), (10, (1.0, 1.0)), (11, (0.5, 0.0))):
        expected[column - 8] = MOST_BESIDE * sum(shares) / 2
    assert torch.allclose(share[10, 8:14], expected)
    assert not share[10, 13:].any()
    assert not compared(measured())[2].share.any()


def test_surfaces_are_compared_with_the_base():
    surfaces, base, beside = compared(measured(r40c40=0.1, r41c41=0.8))
    cell = (0, 0, 10, 10)
    inverse = base.base[0, 0, 20:22, 20:22].mean()
    assert beside.near[cell] == pytest.approx((surfaces.nearest[cell] * inverse).log().item())
    assert beside.far[cell] == pytest.approx((surfaces.farthest[cell] * inverse).log().item())
    assert beside.near[cell] < -APART < APART < beside.far[cell]


def joined(place: float, maps: Measured, inverse: float = 2.0) -> torch.Tensor:
    """The inverse depth at full share of the base, where the network chose another."""
    _, base, beside = compared(maps)
    beside = beside._replace(share=torch.ones_like(beside.share))
    geometry = torch.zeros(1, 2, *GRID)
    geometry[:, 0] = place
    chosen = torch.full_like(base.base, inverse)
    return join_base(chosen, 0.1 / chosen, geometry, base.base, beside)[0]


def test_beside_returns_the_answer_is_the_base_with_its_detail():
    rows = torch.arange(SIZE[0]).float().view(1, 1, -1, 1).expand(1, 1, *SIZE)
    plane = 2 + 0.1 * rows
    mask = (scanned(8) > 0).float()
    for place in (0.0, 0.9 * DEAD_ZONE, -0.9 * DEAD_ZONE):
        found = joined(place, Measured(mask / plane, mask, mask * plane))
        inverse = upsample(found, factor=BASE_CELL)[..., 12:-12, 12:-12]
        assert torch.allclose(inverse, plane[..., 12:-12, 12:-12], rtol=1e-3)


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
    base = torch.full((1, 1, SIZE[0] // 2, SIZE[1] // 2), 4.0)
    beside = Beside(*(torch.full((1, 1, *GRID), value) for value in (near, far, 1.0)))
    geometry = torch.tensor([place, 0.0]).view(1, 2, 1, 1).expand(1, 2, *GRID)
    inverse, _ = join_base(base / 2, 1 / base, geometry, base, beside)
    assert torch.allclose(-(inverse / base).log(), torch.tensor(log_ratio), atol=1e-5)


def test_the_image_keeps_its_share_beside_returns_and_all_of_it_farther():
    one = measured_where(scanned(8, 0.25))
    _, base, beside = compared(one)
    chosen = torch.full_like(base.base, 2.0)
    geometry = torch.zeros(1, 2, *GRID)
    inverse, scale = join_base(chosen, 0.1 / chosen, geometry, base.base, beside)
    share = upsample(beside.share)
    assert 0.9 * MOST_BESIDE < share.max() <= MOST_BESIDE
    inside = (..., slice(12, -12), slice(12, -12))
    assert torch.allclose(inverse[inside], (2.0 + 2.0 * share)[inside], rtol=1e-3)
    relative = float(np.exp(sum(LOG_SCALE) / 2))
    expected = 0.05 + share * (relative / inverse - 0.05)
    assert torch.allclose(scale[inside], expected[inside], rtol=1e-3)
    far = beside._replace(share=torch.zeros_like(beside.share))
    assert torch.equal(join_base(chosen, 0.1 / chosen, geometry, base.base, far)[0], chosen)


def test_a_log_ratio_counts_in_full_from_twice_apart_on():
    ratios = torch.tensor([-2.0, -1.5, -0.9, 0.0, 1.0, 1.5, 2.0, 9.0]) * APART
    weights = torch.tensor([1.0, 0.5, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0])
    assert torch.allclose(apart(ratios), ratios * weights, atol=1e-6)


def test_a_position_has_a_dead_zone_and_can_be_trained_out_of_it():
    x = torch.tensor([-9.0, -1.0, -0.05, 0.05, 0.6, 1.05, 9.0], requires_grad=True)
    found = position(x)
    expected = torch.tensor([-1.0, DEAD_ZONE - 1.0, 0.0, 0.0, 0.6 - DEAD_ZONE, 0.95, 1.0])
    assert torch.allclose(found, expected, atol=1e-6)
    found.sum().backward()
    assert torch.equal(x.grad, torch.ones(7))
    with torch.no_grad():
        assert torch.allclose(position(x), expected, atol=1e-6)


def test_beyond_the_reach_of_the_guess_only_returns_are_answered():
    found = propagated(measured(r40c40=0.05, r41c41=0.8))
    own = torch.full((1, 1, *GRID), 0.45)
    largest = head_of(correction=30.0)
    chosen, _ = choose_surface(largest, own, found, reach=0.5)
    assert chosen[0, 0, 30, 40].item() == pytest.approx(0.5)  # no return is near
    far, _ = choose_surface(head_of(farthest=30.0, correction=30.0), own, found, reach=0.5)
    assert far[0, 0, 10, 10].item() == pytest.approx(0.8, rel=1e-4)


def test_features_lie_in_0_1():
    maps = measured(r0c0=NEAREST / 10, r10c90=1.0, r50c50=0.2)
    surfaces, _, count = propagate_surfaces(maps)
    features = surface_features(surfaces, count)
    assert features.min() >= -1e-6
    assert features.max() <= 1 + 1e-6


def guess_limit(maps: Measured) -> torch.Tensor:
    surfaces, _, count = propagate_surfaces(maps)
    return limit_guess(surfaces, count)


def test_what_returns_nothing_is_no_farther_than_the_returns_around():
    maps = measured(r40c40=0.1, r40c60=0.4, r72c40=0.2)
    limit = guess_limit(maps)[0, 0]
    assert limit[14, 11] == pytest.approx(0.4), "below two returns: the farther one"
    assert limit[19, 10] == pytest.approx(0.2), "below a return"
    assert limit[8, 10] == 1, "over the uppermost return the LiDAR did not look"
    assert limit[10, 30] == 1, "beside the returns neither"
    assert torch.equal(guess_limit(measured()), torch.ones(1, 1, *GRID))


def test_where_nothing_disagrees_the_error_is_a_bounded_share_of_the_depth():
    own, found = torch.full((1, 1, *GRID), 0.5), propagated(measured())
    scales = [
        choose_surface(head_of(scale=logit), own, found)[1][0, 0, 0, 0].item()
        for logit in (-99, 0, 99)
    ]
    middle = sum(LOG_SCALE) / 2
    assert scales == pytest.approx(
        [0.5 * np.exp(log) for log in (LOG_SCALE[0], middle, LOG_SCALE[1])], rel=1e-4
    )


def test_the_error_grows_with_the_spread_of_the_candidates():
    """Half of 0.8 and half of 0.4; then half of 0.05 and half of what that gave."""
    own = torch.full((1, 1, *GRID), 0.4)
    found = propagated(measured(r40c40=0.05, r41c41=0.8))
    found = found._replace(plane=torch.full_like(found.plane, 2.5))
    halves = head_of(farthest=0.0, nearest=0.0, scale=-99.0)
    depth, scale = (maps[0, 0, 10, 10].item() for maps in choose_surface(halves, own, found))
    assert depth == pytest.approx(0.325, rel=1e-3)
    spread = 0.5 * (0.1 + 0.275)
    assert scale == pytest.approx(0.325 * np.exp(LOG_SCALE[0]) + SPREAD_SHARE * spread, rel=1e-3)


@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
def test_the_spread_of_two_depths_is_half_their_mean_distance_from_their_mean(weight):
    depth, spread = replace(*(torch.tensor(value) for value in (0.4, 0.0, 0.2, weight)))
    mean = 0.4 + 0.2 * weight
    assert depth.item() == pytest.approx(mean)
    distance = (1 - weight) * abs(0.4 - mean) + weight * abs(0.6 - mean)
    assert spread.item() == pytest.approx(distance / 2)
    assert replace(*(torch.tensor(value) for value in (0.4, 0.1, 0.0, weight)))[
        1
    ].item() == pytest.approx(0.1 * (1 - weight))


def test_the_scale_does_not_train_the_choice():
    own = torch.full((1, 1, *GRID), 0.4, requires_grad=True)
    head = torch.cat(head_of(plane=0.0, farthest=0.0, nearest=0.0), dim=1).requires_grad_()
    found = propagated(measured(r40c40=0.05, r41c41=0.8))
    choose_surface(HeadChannels.split(head), own, found)[1].sum().backward()
    trained = head.grad.abs().sum(dim=(0, 2, 3)) > 0
    assert trained.tolist() == [False] * 4 + [True] + [False] * 3
    assert own.grad is None or not own.grad.any()


def test_the_nearest_return_is_that_of_a_plain_loop():
    rng = np.random.default_rng(1)
    taken = torch.from_numpy(rng.random(SIZE) < 0.03)
    maps = torch.from_numpy(rng.uniform(0.02, 0.99, SIZE).astype(np.float32)) * taken
    inverse, near, here = (
        found[0, 0].numpy() for found in dilate_returns(measured_where(maps[None, None]))
    )
    depth = maps.numpy()
    assert np.array_equal(here > 0, depth > 0)
    found = 0
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
            if expected:
                assert 1 / inverse[row, column] == pytest.approx(expected, rel=1e-5)
            found += expected > 0
    assert 0.3 < found / (43 * 64) < 0.7


def test_the_head_is_split_into_its_channels_in_their_order():
    head = HeadChannels.split(torch.arange(8.0).view(1, 8, 1, 1))
    assert [part.flatten().tolist() for part in head] == [[0, 1, 2], [3], [4], [5, 6, 7]]
    named = head_of(before=30.0, behind=-30.0, plane=30.0, scale=30.0)
    confidence = torch.sigmoid(named.returns)
    assert confidence.shape == (1, 3, *GRID)
    assert torch.allclose(confidence[0, :, 3, 5], torch.tensor([1.0, 0.0, 0.5]))


DEPTH = torch.full((1, 1, *SIZE), 0.5)
SCALE = torch.full((1, 1, *SIZE), 0.04)


def taken(
    before: float, behind: float, depth: float = 0.5, reduction: float = 0.0, **returns: float
) -> tuple[torch.Tensor, torch.Tensor]:
    confidence = torch.tensor([before, behind, reduction]).view(1, 3, 1, 1).expand(1, 3, *SIZE)
    around = dilate_returns(measured(**returns))
    found = take_returns(
        torch.full_like(DEPTH, depth), SCALE, around, confidence, max_depth_m=RANGE_M
    )
    return found[0][0, 0], found[1][0, 0]


@pytest.mark.parametrize(("returned", "channel"), [(0.05, 0), (0.9, 1)])
def test_a_return_of_full_confidence_is_taken_beside_it_and_nowhere_else(returned, channel):
    """Returns before and behind the predicted depth have a channel of confidence each."""
    for share in (1.0, 0.5, 0.0):
        confidence = [0.0, 0.0]
        confidence[channel] = share
        depth, scale = taken(*confidence, r40c40=returned)
        square = np.s_[38:43, 38:43]
        assert torch.allclose(depth[square], torch.tensor(0.5 + share * (returned - 0.5)))
        spread = share * (1 - share) * abs(returned - 0.5)
        assert torch.allclose(scale[square], torch.tensor(0.04 + SPREAD_SHARE * spread))
        depth[square], scale[square] = 0.5, 0.04
        assert torch.equal(depth, DEPTH[0, 0])
        assert torch.equal(scale, SCALE[0, 0])


def test_the_error_scale_is_reduced_near_returns_only():
    _, scale = taken(0.0, 0.0, reduction=0.4, r40c40=0.05)
    assert torch.allclose(scale[38:43, 38:43], torch.tensor(0.04 * (1 - 0.4 * MAX_SCALE_REDUCTION)))
    scale[38:43, 38:43] = 0.04
    assert torch.equal(scale, SCALE[0, 0])


def test_nothing_measured_is_nothing_taken():
    depth, scale = taken(1.0, 1.0, reduction=1.0)
    assert torch.equal(depth, DEPTH[0, 0])
    assert torch.equal(scale, SCALE[0, 0])


def at_parallax(share: float, depth: float = 0.5) -> float:
    """The normalised depth of a return whose parallax against a depth is a share of PARALLAX."""
    return 1 / (1 / depth - share * RANGE_M * PARALLAX)


def test_a_return_at_the_pixel_that_cannot_show_through_is_taken_without_confidence():
    shares = {
        "r1c1": -0.9,
        "r2c20": -1.5,
        "r3c40": -2.1,
        "r50c1": 0.9,
        "r50c20": 1.5,
        "r50c40": 2.1,
    }
    returns = {place: at_parallax(share) for place, share in shares.items()}
    depth, _ = taken(0.0, 0.0, **returns)
    for place, share in shares.items():
        row, column = (int(number) for number in place[1:].split("c"))
        weight = min(1.0, max(0.0, 2 - abs(share)))
        assert depth[row, column].item() == pytest.approx(
            0.5 + weight * (returns[place] - 0.5), rel=1e-4
        )
        if share < 0:  # beside it one before the predicted depth needs confidence
            assert depth[row, column + 1].item() == 0.5


@pytest.mark.parametrize(
    ("depth", "step", "weight"),
    [
        (0.4, 2.1 * SLOPE, 1.0),
        (0.4, 1.5 * SLOPE, 0.5),
        (0.4, 0.9 * SLOPE, 0.0),  # a slope, which is predicted better than copied
        (0.05, 2.1 * SLOPE, 0.0),  # 10 m: past a surface as near a LiDAR sees
        (0.4, -2.1 * SLOPE, 0.0),  # before it
    ],
)
def test_beside_a_return_one_behind_that_cannot_show_through_is_taken(depth, step, weight):
    returned = depth * (1 + step)
    found, _ = taken(0.0, 0.0, depth, r40c40=returned)
    for row, column in ((38, 38), (40, 42), (39, 41)):
        assert found[row, column].item() == pytest.approx(
            depth + weight * (returned - depth), rel=1e-4
        )
    assert found[40, 43].item() == pytest.approx(depth)


@pytest.mark.parametrize(("range_m", "weight"), [(50.0, 0.0), (200.0, 1.0)])
def test_parallax_is_counted_in_metres(range_m, weight):
    """A return a tenth behind 0.4: 20 and 80 m."""
    around, nothing = dilate_returns(measured(r40c40=0.44)), torch.zeros(1, 3, *SIZE)
    depth = torch.full_like(DEPTH, 0.4)
    found, _ = take_returns(depth, SCALE, around, nothing, max_depth_m=range_m)
    assert found[0, 0, 41, 41].item() == pytest.approx(0.4 + weight * 0.04)
