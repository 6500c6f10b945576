"""Masks of the road teach the one class, and nothing about the others."""

import pytest
import torch

from training.losses.semantic import road_loss


def logits(*, requires_grad=False):
    """Three classes on 4 x 6 pixels, the road the second."""
    values = torch.randn(2, 3, 4, 6, generator=torch.Generator().manual_seed(0))
    return values.requires_grad_(requires_grad)


def test_it_is_the_binary_cross_entropy_of_the_class():
    mask = torch.full((2, 4, 6), 255, dtype=torch.uint8)
    mask[0, 1, 2], mask[0, 3, 5], mask[1, 0, 0] = 1, 0, 0
    p = logits().softmax(dim=1)[:, 1]
    expected = -(p[0, 1, 2].log() + (1 - p[0, 3, 5]).log() + (1 - p[1, 0, 0]).log()) / 3
    torch.testing.assert_close(road_loss(logits(), mask, 1), expected)


def test_it_does_not_say_which_other_class_it_is():
    """Odds among the others stay: their gradients stand in the ratio of their probabilities."""
    values = logits(requires_grad=True)
    road_loss(values, torch.zeros(2, 4, 6, dtype=torch.uint8), 1).backward()
    p = values.detach().softmax(dim=1)
    assert (values.grad[:, 1] > 0).all()
    torch.testing.assert_close(values.grad[:, 0] * p[:, 2], values.grad[:, 2] * p[:, 0])


def test_sure_answers_have_a_finite_loss():
    sure = torch.tensor([500.0, -500.0, 0.0]).view(1, 3, 1, 1)
    mask = torch.ones(1, 1, 1, dtype=torch.uint8)
    assert road_loss(sure, mask, 1).item() == pytest.approx(1000.0)
    assert road_loss(sure, mask, 0).item() == 0


def test_a_coarser_grid_counts_every_pixel_in_its_cell():
    """Logits of cells score as if they were repeated over their pixels, also at the border."""
    coarse = torch.randn(1, 3, 2, 3, generator=torch.Generator().manual_seed(1))
    mask = torch.randint(0, 3, (1, 7, 9), generator=torch.Generator().manual_seed(2))
    mask = torch.where(mask == 2, 255, mask).to(torch.uint8)
    repeated = coarse.repeat_interleave(4, dim=2).repeat_interleave(4, dim=3)[..., :7, :9]
    torch.testing.assert_close(road_loss(coarse, mask, 1), road_loss(repeated, mask, 1))
