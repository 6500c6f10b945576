"""Two views agree where they overlap, and a network with its teacher: what costs how much."""

import math

import pytest
import torch

from training.loading.augment_config import PAIR_BORDER_PX
from training.loading.batch import Pair
from training.losses.agreement import (
    FAR_WEIGHT,
    HALF_CERTAIN,
    NEAR_WEIGHT,
    STEP_ROWS,
    depth_consistency_loss,
    depth_seam_loss,
    distilled_boundary_loss,
    distilled_depth_loss,
    distilled_semantic_loss,
    overlap,
    semantic_consistency_loss,
)

OFFSET = (4, 12)
SIZE = (96, 128)


def views(scene, side=1):
    """The first and the second view of a scene (C, h, w)."""
    rows, columns = (part // side for part in OFFSET)
    height, width = (part // side for part in SIZE)
    return (scene[:, :height, :width], scene[:, rows : rows + height, columns : columns + width])


def scene_of(channels=1, side=1, seed=0):
    generator = torch.Generator().manual_seed(seed)
    size = ((SIZE[0] + 32) // side, (SIZE[1] + 32) // side)
    return torch.rand(channels, *size, generator=generator)


def pair_of(first, second):
    return Pair(torch.tensor([OFFSET]), first[None], second[None])


@pytest.mark.parametrize("side", [1, 2, 4])
def test_the_views_of_one_scene_overlap_in_equal_maps(side):
    a, b = overlap(*views(scene_of(3, side), side), OFFSET, side=side)
    assert torch.equal(a, b)
    border = PAIR_BORDER_PX // side
    rows, columns = OFFSET[0] // side, OFFSET[1] // side
    expected = (SIZE[0] // side - rows - 2 * border, SIZE[1] // side - columns - 2 * border)
    assert a.shape == (3, *expected)


NONE = torch.zeros(1, *SIZE)
ALL = torch.full((1, *SIZE), 9.0)
FALSE = ALL.clone()
FALSE[0, 50, 60] = 3.0


@pytest.mark.parametrize(("lidars", "weight"), [
    ((NONE, NONE), FAR_WEIGHT), ((ALL, ALL), NEAR_WEIGHT), ((ALL, FALSE), FAR_WEIGHT),
    ((ALL, NONE), 0.0),  # a view without LiDAR may have another depth
])  # fmt: skip
def test_depth_that_agrees_costs_nothing_and_a_ratio_its_log(lidars, weight):
    first, second = (view[None] + 0.1 for view in views(scene_of()))
    first.requires_grad_()
    assert depth_consistency_loss(first, second, pair_of(*lidars)) == 0
    loss = depth_consistency_loss(first, second * 1.1, pair_of(*lidars))
    assert loss.item() == pytest.approx(weight * math.log(1.1), rel=1e-4)
    loss.backward()
    assert bool(first.grad.any()) == (weight > 0)


def scan_below(row):
    """LiDAR of both views whose highest return is in this row of the scene."""
    lidar = torch.zeros(1, SIZE[0] + 32, SIZE[1] + 32)
    lidar[:, row:] = 9.0
    return views(lidar)


@pytest.mark.parametrize("fused_first", [True, False])
def test_a_seam_above_the_scan_costs_its_step_and_only_the_fused_view_learns(fused_first):
    scene = scene_of() + 0.5
    seam, edge = scene.clone(), 52
    seam[:, :edge] /= 3.0  # above the scan all is three times as near as without the LiDAR
    seam *= 1.5  # a factor over the whole picture is no seam
    fused, camera = (seam, scene) if fused_first else (scene, seam)
    first = views(fused)[0][None].requires_grad_()
    second = views(camera)[1][None].requires_grad_()
    lidars = scan_below(edge)
    none = torch.zeros(1, *SIZE)
    pair = pair_of(lidars[0], none) if fused_first else pair_of(none, lidars[1])
    loss = depth_seam_loss(first, second, pair)
    # Rows above the edge in the overlap; STEP_ROWS of them lie one step from the scan.
    above = edge - OFFSET[0] - PAIR_BORDER_PX
    assert loss.item() == pytest.approx(math.log(3.0) * STEP_ROWS / above, rel=1e-4)
    loss.backward()
    learning, other = (first, second) if fused_first else (second, first)
    assert learning.grad.any()
    assert other.grad is None


def test_classes_that_agree_cost_nothing_and_others_their_divergence():
    scene = scene_of(5, side=2)
    first, second = (view[None] for view in views(scene, side=2))
    pair = pair_of(torch.zeros(1, *SIZE), torch.zeros(1, *SIZE))
    assert semantic_consistency_loss(first, second, pair, side=2).item() == pytest.approx(0)
    # Two classes with 3/4 and 1/4 in one view and the other way round in the other.
    odds = torch.tensor([math.log(3.0), 0.0]).view(1, 2, 1, 1).expand(1, 2, *first.shape[-2:])
    loss = semantic_consistency_loss(odds, odds.flip(1), pair, side=2)
    assert loss.item() == pytest.approx(math.log(3.0))


ODDS = torch.tensor([math.log(3.0), 0.0]).view(1, 2, 1, 1)  # 3/4 and 1/4


def test_classes_cost_their_divergence_from_the_teachers():
    logits = ODDS.expand(1, 2, 4, 6)
    assert distilled_semantic_loss(logits, logits).item() == pytest.approx(0, abs=1e-6)
    even = torch.zeros(1, 2, 4, 6)
    expected = 0.75 * math.log(1.5) + 0.25 * math.log(0.5)
    assert distilled_semantic_loss(even, logits).item() == pytest.approx(expected)


def test_a_teachers_finer_classes_are_averaged_and_coarser_ones_interpolated():
    fine = ODDS.repeat(1, 1, 4, 4)
    fine[..., ::2] = fine[..., ::2].flip(1)  # the mean of each cell is 1/2
    assert distilled_semantic_loss(torch.zeros(1, 2, 2, 2), fine).item() == pytest.approx(0)
    coarse = ODDS.expand(1, 2, 1, 2)
    same = distilled_semantic_loss(ODDS.expand(1, 2, 2, 4), coarse)
    assert same.item() == pytest.approx(0, abs=1e-6)


def test_depth_costs_its_log_ratio_and_half_where_the_teacher_is_uncertain():
    teacher = torch.full((1, 1, 4, 6), 0.2)
    loss = distilled_depth_loss(teacher * 1.1, teacher, None)
    assert loss.item() == pytest.approx(math.log(1.1), rel=1e-4)
    half = distilled_depth_loss(teacher * 1.1, teacher, teacher * HALF_CERTAIN)
    assert half.item() == pytest.approx(0.5 * math.log(1.1), rel=1e-4)


def test_the_boundary_is_the_teachers_where_the_loss_is_least():
    teacher = torch.randn(1, 1, 4, 6, generator=torch.Generator().manual_seed(0))
    logits = teacher.clone().requires_grad_()
    distilled_boundary_loss(logits, teacher).backward()
    assert logits.grad.abs().max() < 1e-6
    assert distilled_boundary_loss(-teacher, teacher) > distilled_boundary_loss(teacher, teacher)
