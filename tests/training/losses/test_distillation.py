"""A network learns a teacher's answers: what is compared, on which grid, and what counts less."""

import math

import pytest
import torch

from training.losses.distillation import (
    HALF_CERTAIN,
    distilled_boundary_loss,
    distilled_depth_loss,
    distilled_semantic_loss,
)

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
