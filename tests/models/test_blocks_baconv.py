"""BaConv against Eq. 1 written as a plain loop."""

import numpy as np
import torch

from models.blocks import BaConv


def eq1(x, boundary, weight):
    """y(p) = sum over the window of w(p_n) x(p_n) (1 - B(p_n)), zero outside the map."""
    channels, height, width = x.shape
    out = np.zeros((weight.shape[0], height, width))
    for o in range(weight.shape[0]):
        for v in range(height):
            for u in range(width):
                for c in range(channels):
                    for dv in (-1, 0, 1):
                        for du in (-1, 0, 1):
                            y, z = v + dv, u + du
                            if 0 <= y < height and 0 <= z < width:
                                gate = 1 - boundary[y, z]
                                out[o, v, u] += weight[o, c, dv + 1, du + 1] * x[c, y, z] * gate
    return out


def test_baconv_is_eq1():
    torch.manual_seed(0)
    conv = BaConv(3, 4)
    x, boundary = torch.randn(1, 3, 6, 5), torch.rand(1, 1, 6, 5)
    expected = eq1(x[0].numpy(), boundary[0, 0].numpy(), conv.conv.weight.detach().numpy())
    np.testing.assert_allclose(conv(x, boundary)[0].detach().numpy(), expected, atol=1e-5)


def test_full_boundary_gives_zero_and_none_is_a_convolution():
    conv = BaConv(3, 4)
    x = torch.randn(1, 3, 6, 5)
    assert not conv(x, torch.ones(1, 1, 6, 5)).any()
    torch.testing.assert_close(conv(x, torch.zeros(1, 1, 6, 5)), conv.conv(x))
