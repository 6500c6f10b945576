"""The likelihood of depth errors under Laplace distributions."""

import math

import pytest
import torch

from layouts.batch import batch_of
from models import NetworkOutput
from training.losses import LossConfig, SSDNetLoss
from training.losses.uncertainty import laplace_loss

RANGE_M = 100.0


def maps(value: float) -> torch.Tensor:
    return torch.full((1, 1, 4, 6), value)


def loss(scale: torch.Tensor, error_m: float) -> torch.Tensor:
    target = maps(0.2)
    everywhere = torch.ones_like(target, dtype=torch.bool)
    prediction = target + error_m / RANGE_M
    return laplace_loss(scale, prediction, target, everywhere, max_depth_m=RANGE_M)


def test_it_is_the_negative_log_of_the_density_but_for_a_constant():
    density = torch.distributions.Laplace(0.0, 2.0).log_prob(torch.tensor(3.0)).item()
    assert loss(maps(2.0 / RANGE_M), 3.0).item() == pytest.approx(-density - math.log(2), rel=1e-4)


def test_the_best_scale_of_an_error_is_its_size():
    scales = torch.linspace(0.5, 6.0, 56)
    losses = [loss(maps(scale.item() / RANGE_M), 3.0).item() for scale in scales]
    assert scales[losses.index(min(losses))].item() == pytest.approx(3.0, abs=0.051)


def test_its_gradient_goes_only_to_the_scale_of_known_pixels():
    scale = maps(0.02).requires_grad_()
    prediction = maps(0.3).requires_grad_()
    target, known = maps(0.2), torch.zeros(1, 1, 4, 6, dtype=torch.bool)
    known[..., 0] = True
    laplace_loss(scale, prediction, target, known, max_depth_m=RANGE_M).backward()
    assert prediction.grad is None
    assert (scale.grad[known] != 0).all()
    assert not scale.grad[~known].any()


def test_the_whole_loss_has_it_for_networks_with_uncertainty():
    config = LossConfig(depth_weight=0.0, depth_uncertainty_weight=0.5)
    criterion = SSDNetLoss(config, max_depth_m=RANGE_M)
    semantic = torch.full((1, 4, 6), 255)
    depth = maps(20.0)
    sure = NetworkOutput(depths=(maps(0.23),), depth_uncertainty=maps(0.03))
    terms = criterion(sure, batch_of(semantic, depth))
    assert terms["depth_uncertainty"].item() == pytest.approx(1 + math.log(3), rel=1e-4)
    assert terms["total"].item() == pytest.approx(0.5 * (1 + math.log(3)), rel=1e-4)
    unsure = NetworkOutput(depths=(maps(0.23),))
    assert "depth_uncertainty" not in criterion(unsure, batch_of(semantic, depth))
