"""Poolings of few channels against PyTorch's."""

import pytest
import torch
from torch.nn import functional as F

from models.pooling import (
    cell_maxima,
    cell_means,
    maxima_around,
    maxima_beside,
    means_around,
)


def maps(height=16, width=24):
    return torch.randn(2, 2, height, width, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("side", [1, 2, 4, 8])
def test_cells(side):
    x = maps()
    torch.testing.assert_close(cell_means(x, side), F.avg_pool2d(x, side))
    assert torch.equal(cell_maxima(x, side), F.max_pool2d(x, side))


@pytest.mark.parametrize("window", [3, 5, 7, 9, 15])
def test_windows(window):
    x = maps(17, 20)
    torch.testing.assert_close(means_around(x, window), F.avg_pool2d(x, window, 1, window // 2))
    assert torch.equal(maxima_around(x, window), F.max_pool2d(x, window, 1, window // 2))


def test_maxima_beside_leave_the_pixel_itself_out():
    x = maps(9, 11).abs()[:, :1]
    windows = F.unfold(x, 5, padding=2).view(-1, 25, 9, 11)
    windows[:, 12] = 0
    assert torch.equal(maxima_beside(x), windows.amax(dim=1, keepdim=True))


def test_an_exported_graph_has_poolings():
    class Pools(torch.nn.Module):
        def forward(self, x):
            x = cell_means(x, 2) + cell_maxima(x, 2)
            return means_around(x, 3) + maxima_around(x, 5)

    program = torch.export.export(Pools(), (maps(),))
    names = [str(node.target) for node in program.graph.nodes]
    assert sum("avg_pool2d" in name for name in names) == 2
    assert sum("max_pool2d" in name for name in names) == 3
    torch.testing.assert_close(program.module()(maps()), Pools()(maps()))
