"""Building blocks against PyTorch's slower way of the same."""

import pytest
import torch
from torch.nn import functional as F

from models.blocks import BaConv, upsample


@pytest.mark.parametrize("factor", [2, 4, 8])
@pytest.mark.parametrize("size", [(5, 7), (1, 3)])
def test_upsampling_one_channel_and_its_gradient_are_those_of_interpolate(factor, size):
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(2, 1, *size, generator=generator)
    ours, theirs = x.clone().requires_grad_(), x.clone().requires_grad_()
    raised = upsample(ours, factor=factor)
    expected = F.interpolate(
        theirs, scale_factor=float(factor), mode="bilinear", align_corners=False
    )
    assert torch.equal(raised, expected)
    weight = torch.randn(raised.shape, generator=generator)
    (raised * weight).sum().backward()
    (expected * weight).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_a_gate_in_training_is_that_of_evaluation(memory_format):
    layer = BaConv(4, 3)
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(2, 4, 6, 5, generator=generator).to(memory_format=memory_format)
    gradients = []
    for training in (True, False):
        boundary = torch.rand(2, 1, 6, 5, generator=torch.Generator().manual_seed(1))
        boundary.requires_grad_()
        out = layer.train(training)(x, boundary)
        out.square().sum().backward()
        gradients.append((out.detach(), boundary.grad))
    torch.testing.assert_close(*gradients)
