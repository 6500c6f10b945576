"""Candidate surfaces and the choice among them, on grids small enough to count by hand."""

import numpy as np
import pytest
import torch

from models import create_model
from models.surfaces import (
    AGREEMENT,
    NEAREST,
    WINDOWS,
    choose_surface,
    gather_surfaces,
    keep_measurements,
)

SIZE = (96, 128)


def measured(**returns: float) -> torch.Tensor:
    """A map with returns at r<row>c<column> = normalised depth."""
    maps = torch.zeros(1, 2, *SIZE)
    for place, depth in returns.items():
        row, column = (int(number) for number in place[1:].split("c"))
        maps[0, 0, row, column] = depth
        maps[0, 1, row, column] = 1.0
    return maps


def gathered(maps: torch.Tensor):
    return gather_surfaces(maps, factor=2, levels=4)


def test_two_surfaces_in_one_cell_are_kept_apart():
    """5 m and 80 m: the mean of depths, 42.5 m, is a surface that is nowhere."""
    found = gathered(measured(r40c40=0.05, r41c41=0.8))
    cell = (0, 0, 20, 20)
    assert found.nearest[cell].item() == pytest.approx(0.05, rel=1e-4)
    assert found.farthest[cell].item() == pytest.approx(0.8, rel=1e-4)
    # Two returns of inverse depth 20 and 1.25, and next to nothing of the coarser levels.
    assert found.mean[cell].item() == pytest.approx(1 / 10.625, rel=1e-3)
    assert found.density[cell].item() == pytest.approx(0.5)


def test_a_surface_is_carried_as_far_as_the_windows_reach_and_no_further():
    found = gathered(measured(r48c64=0.3))
    reach = sum(window // 2 for window in WINDOWS)
    row, columns = found.support[0, 0, 24], found.nearest[0, 0, 24]
    assert [int(index) for index in torch.nonzero(row).flatten()[[0, -1]]] == [
        max(0, 32 - reach),
        min(63, 32 + reach),
    ]
    inside = columns[row > 0]
    assert inside.min().item() == pytest.approx(0.3, rel=1e-4)
    assert inside.max().item() == pytest.approx(0.3, rel=1e-4)


def test_the_nearest_surface_is_the_nearest_of_a_plain_loop_before_smoothing():
    rng = np.random.default_rng(0)
    maps = torch.zeros(1, 2, *SIZE)
    taken = torch.from_numpy(rng.random(SIZE) < 0.3)
    maps[0, 1] = taken.float()
    maps[0, 0] = torch.from_numpy(rng.uniform(0.02, 0.9, SIZE).astype(np.float32)) * taken
    found = gathered(maps)
    depth = maps[0, 0].numpy()
    for row, column in ((5, 7), (20, 33), (40, 60)):
        cells = []
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                cell = depth[2 * r : 2 * r + 2, 2 * c : 2 * c + 2]
                if cell.any():
                    cells.append(1 / cell[cell > 0].min())
                else:  # filled from the 3 x 3 cells around it
                    around = depth[2 * r - 2 : 2 * r + 4, 2 * c - 2 : 2 * c + 4]
                    assert around.any()
                    cells.append(1 / around[around > 0].min())
        assert found.nearest[0, 0, row, column].item() == pytest.approx(
            1 / np.mean(cells), rel=1e-4
        )


def test_nothing_measured_supports_nothing():
    found = gathered(measured())
    assert not found.support.any()
    assert not found.mean_support.any()
    assert not found.features().any()
    head = torch.full((1, 4, 48, 64), 30.0)
    head[:, 3] = 0.0
    own = torch.full((1, 1, 48, 64), 0.4)
    assert torch.allclose(choose_surface(head, own, found), own)


@pytest.mark.parametrize(("trusted", "expected"), [(0, "mean"), (1, "farthest"), (2, "nearest")])
def test_a_trusted_candidate_is_the_answer(trusted, expected):
    found = gathered(measured(r40c40=0.05, r41c41=0.8))
    head = torch.full((1, 4, 48, 64), -30.0)
    head[:, trusted] = 30.0
    head[:, 3] = 0.0
    own = torch.full((1, 1, 48, 64), 0.4)
    chosen = choose_surface(head, own, found)[0, 0, 20, 20]
    assert chosen.item() == pytest.approx(getattr(found, expected)[0, 0, 20, 20].item(), rel=1e-3)
    head[:, 3] = 30.0  # the largest correction
    corrected = choose_surface(head, own, found)[0, 0, 20, 20]
    assert corrected.item() == pytest.approx(min(1.0, chosen.item() * np.exp(0.5)), rel=1e-3)


def test_features_lie_in_0_1():
    maps = measured(r0c0=NEAREST / 10, r10c90=1.0, r50c50=0.2)
    features = gathered(maps).features()
    assert features.min() >= -1e-6
    assert features.max() <= 1 + 1e-6


def test_returns_that_agree_are_kept_and_others_are_not():
    depth = torch.full((1, 1, *SIZE), 0.5)
    near, far, close = 0.5 * (1 - 0.9 * AGREEMENT), 0.8, 0.5 * (1 + 1.5 * AGREEMENT)
    kept = keep_measurements(depth, measured(r1c1=near, r2c2=far, r3c3=close))[0, 0]
    assert kept[1, 1].item() == pytest.approx(near)
    assert kept[2, 2].item() == pytest.approx(0.5)
    assert 0.5 < kept[3, 3].item() < close
    kept[1, 1] = kept[3, 3] = 0.5
    assert torch.equal(kept, depth[0, 0])


def test_a_network_with_it_answers_at_full_size_and_keeps_the_coarser_depths():
    network = create_model("ssdnet-lite", depth_refine_channels=16).eval()
    rgb = torch.rand(1, 3, 70, 101) * 255
    with torch.no_grad():
        found = network(rgb, torch.full((1, 1, 70, 101), 12.0)).depths
        none = network(rgb, torch.zeros(1, 1, 70, 101)).depths
    assert [tuple(depth.shape[2:]) for depth in found] == [(70, 101), (24, 32), (12, 16), (6, 8)]
    assert none[0].isfinite().all()
    assert found[0].min() >= NEAREST
    assert found[0].max() <= 1.0


def test_it_needs_the_prior_and_two_stem_layers():
    for changes in (
        {"depth_prior": False},
        {"stem_channels": (32,), "semantic_refine_channels": 0},
    ):
        with pytest.raises(ValueError, match="depth_refine_channels"):
            create_model("ssdnet-lite", depth_refine_channels=16, **changes)
