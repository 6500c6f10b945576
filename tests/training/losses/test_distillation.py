"""A network learns a teacher's answers: what is compared, on which grid, and what counts less."""

import math

import pytest
import torch

from layouts.batch import batch_of
from models import NetworkOutput
from training.losses import LossConfig, SSDNetLoss
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


def answers(seed, size=(32, 48)):
    generator = torch.Generator().manual_seed(seed)
    return NetworkOutput(
        semantic_logits=torch.randn(2, 5, size[0] // 2, size[1] // 2, generator=generator),
        depths=(0.1 + torch.rand(2, 1, *size, generator=generator),),
        boundary_logits=torch.randn(2, 1, *size, generator=generator),
        depth_uncertainty=torch.rand(2, 1, *size, generator=generator),
    )


def test_the_whole_loss_has_the_terms_of_a_teacher_on_pictures_without_labels():
    config = LossConfig(
        distilled_semantic_weight=1.0, distilled_depth_weight=2.0, distilled_boundary_weight=0.5
    )
    criterion = SSDNetLoss(config, max_depth_m=100.0)
    labels, depth = torch.full((2, 32, 48), 255), torch.zeros(2, 1, 32, 48)
    alone = criterion(answers(0), batch_of(labels, depth))
    terms = criterion(answers(0), batch_of(labels, depth, teacher=answers(1)))
    added = {"distilled_semantic": 1.0, "distilled_depth": 2.0, "distilled_boundary": 0.5}
    assert set(terms) - set(alone) == set(added)
    expected = alone["total"] + sum(weight * terms[name] for name, weight in added.items())
    assert terms["total"].item() == pytest.approx(expected.item(), rel=1e-5)
