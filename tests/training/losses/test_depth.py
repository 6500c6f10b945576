"""Eq. 2-4 against plain loops and cases by hand; the likelihood of errors."""

import math

import numpy as np
import pytest
import torch

from training.losses.depth import (
    depth_at_scale,
    laplace_loss,
    metric_depth_loss,
    normalise_depth,
    paper_depth_loss,
    ssim_loss,
)
from training.losses.masked import masked_mean, split_into_blocks

C1, C2, C3 = 1e-4, 9e-4, 4.5e-4


def smooth_pair(shape, seed=0):
    """A prediction near a target, both in 0..1: float32 (N, 1, H, W)."""
    rng = np.random.default_rng(seed)
    target = rng.random(shape, dtype=np.float32)
    prediction = np.clip(target + 0.2 * rng.standard_normal(shape), 0, 1).astype(np.float32)
    return torch.from_numpy(prediction), torch.from_numpy(target)


def ssim_by_windows(a, b, valid, window=11):
    """Mean of l * c * s, Eq. 3 with its three factors, over windows with a valid pixel."""
    values = []
    for v, u in np.ndindex(a.shape[0] - window + 1, a.shape[1] - window + 1):
        place = np.s_[v : v + window, u : u + window]
        xs, ys = (x[place][valid[place]].astype(np.float64) for x in (a, b))
        if not xs.size:
            continue
        (var_x, covariance), (_, var_y) = np.cov(xs, ys, ddof=0)
        deviations = (var_x * var_y) ** 0.5
        luminance = (2 * xs.mean() * ys.mean() + C1) / (xs.mean() ** 2 + ys.mean() ** 2 + C1)
        contrast = (2 * deviations + C2) / (var_x + var_y + C2)
        values.append(luminance * contrast * (covariance + C3) / (deviations + C3))
    return sum(values) / len(values)


def test_ssim_loss_equals_windows_with_holes():
    prediction, target = smooth_pair((2, 1, 15, 18), seed=1)
    valid = torch.from_numpy(np.random.default_rng(2).random((2, 1, 15, 18)) < 0.1)
    valid[1, :, :, :14] = False  # windows without any ground truth
    expected = np.mean(
        [
            1 - ssim_by_windows(*(x[n, 0].numpy() for x in (prediction, target, valid)))
            for n in range(2)
        ]
    )
    assert ssim_loss(prediction, target, valid).item() == pytest.approx(expected, abs=2e-5)


def test_normalise_depth_keeps_only_measurements():
    depth = torch.tensor([0.0, -1.0, 50.0, 100.0, 100.5, float("nan"), float("inf")])
    normalised, valid = normalise_depth(depth.view(1, 1, 1, 7), 200.0, 100.0)
    assert valid.flatten().tolist() == [False, False, True, True, False, False, False]
    assert normalised.flatten().tolist() == [0, 0, 0.25, 0.5, 0, 0, 0]


def test_depth_at_scale_is_the_mean_of_valid_pixels():
    rng = np.random.default_rng(3)
    valid = rng.random((13, 21)) < 0.3
    target = np.where(valid, rng.random((13, 21)), 0).astype(np.float32)
    valid[:4, :4] = False
    target[:4, :4] = 0
    ours, known = depth_at_scale(
        torch.from_numpy(target)[None, None], torch.from_numpy(valid)[None, None], (4, 6)
    )
    for v in range(4):
        for u in range(6):
            block = target[4 * v : 4 * v + 4, 4 * u : 4 * u + 4]
            block_valid = valid[4 * v : 4 * v + 4, 4 * u : 4 * u + 4]
            assert known[0, 0, v, u] == block_valid.any()
            expected = block[block_valid].mean() if block_valid.any() else 0.0
            assert ours[0, 0, v, u] == pytest.approx(expected, abs=1e-6)
    assert not known[0, 0, 0, 0]


@pytest.mark.parametrize(("size", "grid", "side"), [
    ((125, 414), (125, 414), 1), ((125, 414), (63, 207), 2), ((125, 414), (8, 26), 16),
    ((33, 33), (8, 8), 8),  # a network that pads 33 to 64
    ((8, 414), (1, 26), 16),  # the height alone would do with 8
    ((320, 448), (80, 112), 4),
])  # fmt: skip
def test_block_side_of_a_grid(size, grid, side):
    blocks, found = split_into_blocks(torch.ones(1, 1, *size), grid)
    assert found == side
    assert blocks.shape[-2:] == (grid[0] * side, grid[1] * side)
    assert blocks.sum() == size[0] * size[1]


def test_masked_mean_counts_samples_alike():
    values = torch.tensor([[1.0, 1.0, 1.0, 1.0], [5.0, 9.0, 9.0, 9.0], [7.0, 7.0, 7.0, 7.0]])
    mask = torch.tensor([[1, 1, 1, 1], [1, 0, 0, 0], [0, 0, 0, 0]], dtype=torch.bool)
    assert masked_mean(values.view(3, 1, 2, 2), mask.view(3, 1, 2, 2)).item() == 3.0


def test_paper_depth_loss_by_hand():
    # Errors 0.1 and 0.3 on the two valid pixels; the third would be 0.9.
    prediction = torch.tensor([0.6, 0.2, 0.9]).view(1, 1, 1, 3)
    target = torch.tensor([0.5, 0.5, 0.0]).view(1, 1, 1, 3)
    expected = 0.4 * 0.2 + 0.4 * (0.01 + 0.09) / 2
    expected += 0.2 * ssim_loss(prediction, target, target > 0).item()
    loss = paper_depth_loss(prediction, target, target > 0)
    assert loss.item() == pytest.approx(expected, abs=1e-6)


def test_metric_depth_loss_by_hand():
    """The log of the ratio counts near and far alike; farther than the sky is right for it."""
    prediction = torch.tensor([0.01, 0.4, 0.7, 0.7, 0.9]).view(1, 1, 1, 5).requires_grad_()
    target = torch.tensor([0.02, 0.5, 0.5, 0.3, 0.0]).view(1, 1, 1, 5)
    options = {"max_depth_m": 100.0, "l2": 0.02, "log": 10.0, "unmeasured_share": 0.5}
    loss = metric_depth_loss(prediction, target, target > 0, **options)
    metres, ratios = np.array([1, 10, 0, 40]), np.array([2, 5 / 4, 1, 7 / 3])
    expected = np.mean(metres + 0.02 * metres**2 + 10 * np.log(ratios))
    assert loss.item() == pytest.approx(expected, rel=1e-5)
    (gradient,) = torch.autograd.grad(loss, prediction)
    assert torch.sign(gradient).flatten().tolist() == [-1, -1, 0, 1, 0]


RANGE_M = 100.0


def maps(value: float) -> torch.Tensor:
    return torch.full((1, 1, 4, 6), value)


def likelihood(scale: torch.Tensor, error_m: float) -> torch.Tensor:
    target = maps(0.2)
    everywhere = torch.ones_like(target, dtype=torch.bool)
    prediction = target + error_m / RANGE_M
    return laplace_loss(scale, prediction, target, everywhere, max_depth_m=RANGE_M)


def test_the_likelihood_is_the_negative_log_of_the_density_but_for_a_constant():
    density = torch.distributions.Laplace(0.0, 2.0).log_prob(torch.tensor(3.0)).item()
    assert likelihood(maps(2.0 / RANGE_M), 3.0).item() == pytest.approx(
        -density - math.log(2), rel=1e-4
    )


def test_the_gradient_of_the_likelihood_goes_only_to_the_scale_of_known_pixels():
    scale = maps(0.02).requires_grad_()
    prediction = maps(0.3).requires_grad_()
    target, known = maps(0.2), torch.zeros(1, 1, 4, 6, dtype=torch.bool)
    known[..., 0] = True
    laplace_loss(scale, prediction, target, known, max_depth_m=RANGE_M).backward()
    assert prediction.grad is None
    assert (scale.grad[known] != 0).all()
    assert not scale.grad[~known].any()
