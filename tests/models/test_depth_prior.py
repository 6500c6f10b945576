"""The pull-push fill on cases that can be worked out by hand."""

import torch

from models.depth_prior import pull_push_fill


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


def test_measured_cell_is_not_washed_out_by_its_neighbours():
    depth = torch.zeros(1, 1, 64, 64)
    depth[0, 0, 4, 4], depth[0, 0, 4, 20] = 0.1, 0.9
    prior = fill(depth)
    assert abs(float(prior.filled[0, 0, 1, 1]) - 0.1) < 0.02
    assert abs(float(prior.filled[0, 0, 1, 5]) - 0.9) < 0.02
