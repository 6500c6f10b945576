"""Building blocks against PyTorch's slower way of the same."""

import pytest
import torch
from torch.nn import functional as F

from models.blocks import BaConv, upsample


@pytest.mark.parametrize("factor", [2, 4, 8])
@pytest.mark.parametrize("shape", [(2, 1, 5, 7), (1, 1, 1, 3), (2, 3, 4, 6)])
def test_upsampling_few_channels_and_its_gradient_are_those_of_interpolate(factor, shape):
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(*shape, generator=generator).to(memory_format=torch.channels_last)
    ours, theirs = x.clone().requires_grad_(), x.clone().requires_grad_()
    raised = upsample(ours, factor=factor)
    expected = F.interpolate(
        theirs, scale_factor=float(factor), mode="bilinear", align_corners=False
    )
    torch.testing.assert_close(raised, expected)
    weight = torch.randn(raised.shape, generator=generator)
    (raised * weight).sum().backward()
    (expected * weight).sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_a_gate_is_a_product_in_either_layout(memory_format):
    layer = BaConv(4, 3)
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(2, 4, 6, 5, generator=generator).to(memory_format=memory_format)
    ours = torch.rand(2, 1, 6, 5, generator=generator).requires_grad_()
    theirs = ours.detach().clone().requires_grad_()
    out, expected = layer(x, ours), layer.conv(x * (1 - theirs))
    torch.testing.assert_close(out, expected)
    out.square().sum().backward()
    expected.square().sum().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)
