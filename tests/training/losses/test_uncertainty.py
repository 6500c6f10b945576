"""The likelihood of depth errors under Laplace distributions."""

import math

import pytest
import torch

from training.losses.depth import laplace_loss

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


def test_its_gradient_goes_only_to_the_scale_of_known_pixels():
    scale = maps(0.02).requires_grad_()
    prediction = maps(0.3).requires_grad_()
    target, known = maps(0.2), torch.zeros(1, 1, 4, 6, dtype=torch.bool)
    known[..., 0] = True
    laplace_loss(scale, prediction, target, known, max_depth_m=RANGE_M).backward()
    assert prediction.grad is None
    assert (scale.grad[known] != 0).all()
    assert not scale.grad[~known].any()
