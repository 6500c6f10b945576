"""The choice among the candidates of the depth, on grids small enough to count by hand."""

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from models.blocks import upsample
from models.depth_choice import (
    DEAD_ZONE,
    LOG_SCALE,
    MAX_SCALE_REDUCTION,
    PARALLAX,
    SLOPE,
    SPREAD_SHARE,
    STRETCH,
    BaseMaps,
    Choices,
    Chosen,
    HeadChannels,
    blend_with_base,
    blend_with_returns,
    choose_surface,
    limit_correction,
    log_offset,
    reduce_scale,
    soft_threshold,
    start_from_returns,
    stretched_sigmoid,
)
from models.planes import BASE_CELL, CELL
from models.pooling import cell_maxima
from models.surfaces import (
    MAX_BASE_WEIGHT,
    SAME_SURFACE,
    Surfaces,
    compare_with_base,
    dilate_returns,
    find_near_returns,
    propagate_surfaces,
    zero_if_same_surface,
)
from small_returns import (
    CELL_OF_TWO,
    GRID,
    RANGE_M,
    SIZE,
    TWO,
    grid_of,
    returns_at,
    road,
    scan_lines,
)

# Logits of the head in their order, and those that leave the monocular depth as it is.
NO_CHOICE = {"plane": -30.0, "farthest": -30.0, "nearest": -30.0}
CHANNELS = (*NO_CHOICE, "correction", "scale", "before", "behind", "reduction")
INSIDE = (..., slice(12, -12), slice(12, -12))


def head_of(**logits):
    """Logits of the named channels; the others leave the monocular depth as it is."""
    values = [(NO_CHOICE | logits).get(name, 0.0) for name in CHANNELS]
    return HeadChannels.split(torch.tensor(values).view(1, -1, 1, 1).expand(1, -1, *GRID))


def choices_of(returns, monocular, **changes):
    """What a head chooses among; `changes` replaces surfaces."""
    surfaces, fit = propagate_surfaces(returns)
    surfaces = surfaces._replace(**changes)
    limit = limit_correction(compare_with_base(surfaces, fit), surfaces.support)
    return Choices(*surfaces, grid_of(monocular), limit)


def choose(head, choices, farthest=1.0):
    """The depth that is chosen, and the scale of its error."""
    chosen = choose_surface(head, choices, unmeasured_share=farthest)
    return 1 / chosen.inverse, chosen.scale


def blend(inverse, base, scale=0.1, *, offset=0.0, relative_scale=1.0, weight=1.0):
    """Inverse depth and scale of a choice that is blended with the base."""
    maps = (torch.as_tensor(value) for value in (offset, relative_scale, weight))
    chosen = Chosen(torch.as_tensor(inverse), torch.as_tensor(scale))
    return blend_with_base(chosen, base, BaseMaps(torch.zeros(()), *maps))


@pytest.mark.parametrize(
    ("returns", "logits", "monocular", "expected"),
    [
        (returns_at(TWO), {"farthest": 30.0}, 0.4, 0.8),
        (returns_at(TWO), {"nearest": 30.0}, 0.4, 0.05),
        (returns_at(TWO), {"farthest": 30.0, "correction": 30.0}, 0.4, 1.0),
        (returns_at(TWO), {"nearest": 30.0, "correction": 30.0}, 0.4, 0.05 * np.exp(0.5)),
        # Where both surfaces agree there is no room for a correction.
        (scan_lines(8), {"plane": -30.0, "correction": 30.0}, 0.45, 0.45),
        (scan_lines(8), {"plane": 0.0, "correction": 30.0}, 0.45, (0.2 + 0.45) / 2),
        (scan_lines(8), {"plane": 30.0, "correction": 30.0}, 0.45, 0.2),
        (returns_at({}), {"plane": 30.0, "farthest": 30.0, "nearest": 30.0}, 0.4, 0.4),
    ],
)
def test_a_candidate_replaces_others_by_the_confidence_in_it(returns, logits, monocular, expected):
    depth, _ = choose(head_of(**logits), choices_of(returns, monocular))
    assert depth[CELL_OF_TWO] == pytest.approx(expected, rel=1e-3)


def test_without_a_picture_the_answer_is_the_plane_or_the_farthest_surface():
    choices, cell = choices_of(scan_lines(8, 0.2), 0.9), CELL_OF_TWO
    surfaces = Surfaces(*choices[:5])._replace(farthest=grid_of(0.5))
    for shows, plane, expected in ((1, 1, 0.9), (0, 1, 0.2), (0, 0, 0.5), (0.5, 0, 0.7)):
        given = surfaces._replace(plane_support=grid_of(float(plane)))
        shown = torch.full((1, 1, 1, 1), float(shows))
        start = start_from_returns(grid_of(0.9), given, shown)
        assert start[cell] == pytest.approx(expected, rel=1e-3)
    nothing = torch.zeros(1, 1, 1, 1)
    head = head_of(nearest=30.0, farthest=30.0)
    chosen = choose_surface(head, choices, unmeasured_share=1.0, shows=nothing)
    assert 1 / chosen.inverse[cell] == pytest.approx(0.9, rel=1e-3)


def test_a_correction_stays_between_both_surfaces():
    choices = choices_of(scan_lines(8, 0.3), 0.45, farthest=grid_of(0.36))
    corrected, _ = choose(head_of(plane=30.0, correction=30.0), choices)
    assert torch.allclose(corrected, torch.tensor(0.36), rtol=1e-3)


@pytest.mark.parametrize(
    ("logits", "cell", "expected"),
    [({}, (0, 0, 30, 40), 0.5), ({"farthest": 30.0}, CELL_OF_TWO, 0.8)],
)
def test_beyond_the_farthest_monocular_depth_only_returns_are_chosen(logits, cell, expected):
    head = head_of(correction=30.0, **logits)
    chosen, _ = choose(head, choices_of(returns_at(TWO), 0.45), farthest=0.5)
    assert chosen[cell] == pytest.approx(expected, rel=1e-4)


def test_a_plane_is_chosen_without_confidence_in_surfaces():
    inverse, returns = road()
    depth, _ = choose(head_of(plane=30.0), choices_of(returns, 0.45))
    expected = F.avg_pool2d(inverse, CELL)
    assert torch.allclose((1 / depth)[..., 3:-3, :], expected[..., 3:-3, :], rtol=1e-3)


@pytest.mark.parametrize(("logit", "log"), [(-99, LOG_SCALE[0]), (0, -2.5), (99, LOG_SCALE[1])])
@pytest.mark.parametrize(("returns", "expected"), [({}, 0.4), (TWO, 0.325)])
def test_the_error_is_a_bounded_share_of_the_depth(logit, log, returns, expected):
    """The depth is half of 0.8 and half of 0.4, then half of 0.05 and half of that result."""
    choices = choices_of(returns_at(returns), 0.4, inverse_plane=grid_of(2.5))
    maps = choose(head_of(farthest=0.0, nearest=0.0, scale=logit), choices)
    depth, scale = (each[CELL_OF_TWO] for each in maps)
    assert depth == pytest.approx(expected, rel=1e-3)
    assert scale == pytest.approx(expected * np.exp(log), rel=1e-3)


def test_the_scale_does_not_train_the_choice():
    choices = choices_of(returns_at(TWO), 0.4)
    choices.start.requires_grad_()
    head = torch.cat(head_of(plane=0.0, farthest=0.0, nearest=0.0), dim=1).requires_grad_()
    choose(HeadChannels.split(head), choices)[1].sum().backward()
    trained = head.grad.abs().sum(dim=(0, 2, 3)) > 0
    assert [CHANNELS[index] for index in torch.nonzero(trained).flatten()] == ["scale"]
    assert choices.start.grad is None or not choices.monocular.grad.any()


def test_a_confidence_reaches_0_and_1_and_can_be_trained_back():
    logits = torch.tensor([-9.0, -2.5, -2.3, 0.0, 2.3, 2.5, 9.0], requires_grad=True)
    found = stretched_sigmoid(logits)
    assert torch.allclose(found[[0, 1, 3, 5, 6]], torch.tensor([0, 0, 0.5, 1, 1]))
    assert 0 < found[2] < 0.02 < 0.98 < found[4] < 1
    found.sum().backward()
    share = torch.sigmoid(logits.detach())
    assert torch.allclose(logits.grad, (1 + 2 * STRETCH) * share * (1 - share))
    with torch.no_grad():
        assert torch.allclose(stretched_sigmoid(logits), found)


def test_a_position_has_a_dead_zone_and_can_be_trained_out_of_it():
    x = torch.tensor([-9.0, -1.0, -0.05, 0.05, 0.6, 1.05, 9.0], requires_grad=True)
    found = soft_threshold(x)
    expected = torch.tensor([-1.0, DEAD_ZONE - 1.0, 0.0, 0.0, 0.6 - DEAD_ZONE, 0.95, 1.0])
    assert torch.allclose(found, expected, atol=1e-6)
    found.sum().backward()
    assert torch.equal(x.grad, torch.ones(7))
    with torch.no_grad():
        assert torch.allclose(soft_threshold(x), expected, atol=1e-6)


@pytest.mark.parametrize("position", [0.0, 0.9 * DEAD_ZONE, -0.9 * DEAD_ZONE])
def test_at_full_weight_the_answer_is_the_base_with_its_detail(position):
    inverse, returns = road()
    surfaces, fit = propagate_surfaces(returns)
    nearest, farthest, _ = compare_with_base(surfaces, fit)
    offsets = zero_if_same_surface(torch.cat([nearest, farthest], dim=1))
    offset = upsample(log_offset(soft_threshold(grid_of(position)), offsets))
    found = blend(2.0, fit.inverse_base, offset=offset).inverse
    assert torch.allclose(upsample(found, factor=BASE_CELL)[INSIDE], inverse[INSIDE], rtol=1e-3)


@pytest.mark.parametrize(
    ("position", "nearest", "farthest", "log_ratio"),
    [
        (-1.2, -1.0, 0.5, -1.0),
        (1.2, -1.0, 0.5, 0.5),
        (0.5 + DEAD_ZONE, -1.0, 0.5, 0.25),
        (-0.5 - DEAD_ZONE, -1.0, 0.5, -0.5),
        (1.2, -1.0, 0.9 * SAME_SURFACE, 0.0),  # one surface
        (-1.2, -0.9 * SAME_SURFACE, 0.5, 0.0),
    ],
)
def test_the_base_departs_to_a_surface_and_only_where_there_are_two(
    position, nearest, farthest, log_ratio
):
    offsets = zero_if_same_surface(torch.tensor([nearest, farthest]).view(1, 2, 1, 1))
    offset = log_offset(soft_threshold(torch.tensor(position)), offsets)
    assert offset.item() == pytest.approx(log_ratio, abs=1e-5)
    base = torch.tensor(4.0)
    inverse = blend(2.0, base, offset=offset).inverse
    assert -(inverse / base).log().item() == pytest.approx(log_ratio, abs=1e-5)


def test_the_choice_keeps_its_weight_beside_returns_and_all_of_it_farther():
    surfaces, fit = propagate_surfaces(scan_lines(8, 0.25))
    weight = upsample(compare_with_base(surfaces, fit).base_weight)
    inverse, scale = blend(2.0, fit.inverse_base, 0.05, relative_scale=0.3, weight=weight)
    assert 0.9 * MAX_BASE_WEIGHT < weight.max() <= MAX_BASE_WEIGHT
    assert torch.allclose(inverse[INSIDE], (2.0 + 2.0 * weight)[INSIDE], rtol=1e-3)
    expected = 0.05 + weight * (0.3 / inverse - 0.05)
    assert torch.allclose(scale[INSIDE], expected[INSIDE], rtol=1e-3)
    assert (blend(2.0, fit.inverse_base, weight=0.0).inverse == 2.0).all()


def taken_of(before, behind, depth=0.5, returns=None, range_m=RANGE_M):
    """Return the depth after returns were taken, and what the spread adds to the scale."""
    inverse, *confidence = (torch.full((1, 1, *SIZE), x) for x in (1 / depth, before, behind))
    returns = dilate_returns(returns_at(returns or {}))
    found = blend_with_returns(inverse, returns, *confidence, max_depth_m=range_m)
    return found[0][0, 0], found[1][0, 0]


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
@pytest.mark.parametrize(("returned", "channel"), [(0.05, 0), (0.9, 1)])
def test_a_return_is_taken_by_its_confidence_beside_it_and_nowhere_else(returned, channel, share):
    """Returns before and behind the predicted depth have a channel of confidence each."""
    confidence = [0.0, 0.0]
    confidence[channel] = share
    depth, spread = taken_of(*confidence, returns={(40, 40): returned})
    square = np.s_[38:43, 38:43]
    assert torch.allclose(depth[square], torch.tensor(0.5 + share * (returned - 0.5)))
    expected = torch.tensor(SPREAD_SHARE * share * (1 - share) * abs(returned - 0.5))
    assert torch.allclose(spread[square], expected, atol=1e-6)
    depth[square], spread[square] = 0.5, 0.0
    assert (depth == 0.5).all()
    assert not spread.any()


def test_the_scale_is_reduced_beside_a_return_alone():
    near = torch.tensor([1.0, 0.0]).view(1, 1, 1, 2)
    reduced = reduce_scale(torch.full_like(near, 0.04), torch.full_like(near, 0.4), near)
    expected = 0.04 * torch.tensor([1 - 0.4 * MAX_SCALE_REDUCTION, 1.0])
    assert torch.allclose(reduced.flatten(), expected)


@pytest.mark.parametrize("pixel", [(40, 40), (41, 40), (41, 41)])
def test_the_cells_near_a_return_are_those_with_a_pixel_that_it_reaches(pixel):
    _, fit = propagate_surfaces(returns_at({pixel: 0.3}))
    reached = dilate_returns(returns_at({pixel: 0.3})).mask
    assert torch.equal(find_near_returns(fit), cell_maxima(reached, BASE_CELL))


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


def test_without_returns_nothing_is_taken():
    depth, spread = taken_of(1.0, 1.0)
    assert (depth == 0.5).all()
    assert not spread.any()
