"""The pull-push fill on cases that can be worked out by hand."""

from typing import NamedTuple

import torch

from models.pull_push import pull_push


class Filled(NamedTuple):
    """The weighted mean, its support and the share of measured pixels."""

    filled: torch.Tensor
    support: torch.Tensor
    density: torch.Tensor


def pull_push_fill(measured, *, factor, levels):
    carried, density = pull_push(measured, factor=factor, levels=levels)
    weighted, support = carried[:, :1], carried[:, 1:]
    return Filled(weighted / support.clamp(min=1e-6), support, density)


def fill(depth, **options):
    measured = torch.cat((depth, (depth > 0).float()), dim=1)
    return pull_push_fill(measured, **{"factor": 4, "levels": 3, **options})


def test_nothing_measured_is_zero_without_support():
    prior = fill(torch.zeros(1, 1, 64, 64))
    assert not prior.filled.any()
    assert not prior.density.any()
    assert not prior.support.any()


def test_constant_depth_stays_constant_where_supported():
    depth = torch.full((1, 1, 64, 64), 0.3)
    prior = fill(depth)
    torch.testing.assert_close(prior.filled, torch.full((1, 1, 16, 16), 0.3), rtol=2e-3, atol=0)
    torch.testing.assert_close(prior.density, torch.ones(1, 1, 16, 16))


def test_one_return_fills_its_coarse_cell_and_keeps_its_value():
    depth = torch.zeros(1, 1, 64, 64)
    depth[0, 0, 5, 6] = 0.4  # cell (1, 1) of the 4x grid, coarse cell (0, 0) of 32x32
    prior = fill(depth)
    assert abs(float(prior.filled[0, 0, 1, 1] / 0.4) - 1) < 0.05
    supported = prior.support[0, 0] > 1e-5
    values = prior.filled[0, 0][supported]
    assert len(values) >= 64  # its whole coarse cell
    torch.testing.assert_close(values, torch.full_like(values, 0.4), rtol=1e-4, atol=0)
    assert prior.density[0, 0, 1, 1] == 1 / 16
    assert not prior.density[0, 0, 0, 0]
    assert not prior.support[0, 0, 15:, 15:].any()  # beyond every level's reach
    assert not prior.filled[0, 0, 15:, 15:].any()


def test_a_cell_without_a_return_takes_the_coarser_level_at_its_weight():
    """Two cells of one pixel, measured 0.2 and nothing; one coarse cell over both, weight 1e-3.

    The coarse cell holds half of 0.2 and half a measurement: 0.1 / 0.501 and 0.5 / 0.501. The
    measured cell becomes (0.2 + 1e-3 * 0.1 / 0.501) / 1.001 with the support
    (1 + 1e-3 * 0.5 / 0.501) / 1.001; the other has the coarse cell's values.
    """
    measured = torch.zeros(1, 2, 2, 2)
    measured[0, 0, :, 0], measured[0, 1, :, 0] = 0.2, 1.0
    prior = pull_push_fill(measured, factor=1, levels=1)
    support = torch.tensor([[0.9999980, 0.9980040], [0.9999980, 0.9980040]])
    torch.testing.assert_close(prior.support[0, 0], support, rtol=0, atol=2e-7)
    torch.testing.assert_close(prior.filled[0, 0], torch.full((2, 2), 0.2))


def test_the_coarser_level_counts_a_thousandth_of_a_full_cell():
    """Half-measured cells of 0.2 and 0.8 under one coarse cell, whose mean is 0.5.

    Pulled: (0.1, 0.5) and (0.4, 0.5); the coarse cell (0.25, 0.5) / 0.501 = (0.499002, 0.998004).
    Pushed, the left: (0.1 + 1e-3 * 0.499002) / 0.501 = 0.200597 over
    (0.5 + 1e-3 * 0.998004) / 0.501 = 0.999996.
    """
    measured = torch.zeros(1, 2, 4, 4)
    measured[0, 1, ::2] = 1.0  # every second row
    measured[0, 0, ::2, :2], measured[0, 0, ::2, 2:] = 0.2, 0.8
    prior = pull_push_fill(measured, factor=2, levels=1)
    near, far = 0.200597 / 0.999996, (0.4 + 1e-3 * 0.499002) / 0.501 / 0.999996
    expected = torch.tensor([[near, far], [near, far]])
    torch.testing.assert_close(prior.filled[0, 0], expected, rtol=0, atol=2e-6)


def test_measured_cell_is_not_washed_out_by_its_neighbours():
    depth = torch.zeros(1, 1, 64, 64)
    depth[0, 0, 4, 4], depth[0, 0, 4, 20] = 0.1, 0.9
    prior = fill(depth)
    assert abs(float(prior.filled[0, 0, 1, 1]) - 0.1) < 0.02
    assert abs(float(prior.filled[0, 0, 1, 5]) - 0.9) < 0.02
