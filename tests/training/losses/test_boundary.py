"""Boundary ground truth against plain loops and cases by hand, and Eq. 6 as printed."""

import numpy as np
import pytest
import torch

from training.losses.boundary import balanced_cross_entropy, boundary_at_scale, boundary_target


def test_boundary_target_equals_loops():
    semantic = np.random.default_rng(0).choice([0, 0, 1, 2, 255], size=(2, 9, 11))
    target, valid = boundary_target(torch.from_numpy(semantic))
    for n, v, u in np.ndindex(*semantic.shape):
        here = semantic[n, v, u]
        before = [semantic[n, v, u - 1]] * (u > 0) + [semantic[n, v - 1, u]] * (v > 0)
        differs = here != 255 and any(other not in (255, here) for other in before)
        decided = here != 255 and (differs or 255 not in before)
        assert target[n, 0, v, u] == differs
        assert valid[n, 0, v, u] == decided


def test_boundary_at_scale_takes_any_pixel_of_a_cell():
    target = torch.zeros(1, 1, 5, 6, dtype=torch.bool)
    valid = torch.ones_like(target)
    target[0, 0, 1, 3] = True
    target[0, 0, 4, 0] = True
    valid[0, 0, 4, 0] = False  # not known, so it does not count
    valid[0, 0, :2, :2] = False
    coarse, known = boundary_at_scale(target, valid, (3, 3))
    assert coarse.int().tolist() == [[[[0, 1, 0], [0, 0, 0], [0, 0, 0]]]]
    assert known.int().tolist() == [[[[0, 1, 1], [1, 1, 1], [1, 1, 1]]]]


def test_balanced_cross_entropy_is_its_formula():
    rng = np.random.default_rng(1)
    logits = rng.standard_normal((2, 1, 6, 7))
    target = rng.random((2, 1, 6, 7)) < np.array([0.1, 0.4]).reshape(2, 1, 1, 1)
    valid = rng.random((2, 1, 6, 7)) < 0.8
    sample_weight = np.array([0.3, 1.0])
    ours = balanced_cross_entropy(*map(torch.from_numpy, (logits, target, valid, sample_weight)))
    beta, p = (valid & ~target).sum() / valid.sum(), 1 / (1 + np.exp(-logits))
    entropy = np.where(target, beta * np.log(p), (1 - beta) * np.log(1 - p))
    expected = -(entropy * valid * sample_weight.reshape(2, 1, 1, 1)).sum() / valid.sum()
    assert ours.item() == pytest.approx(expected, rel=1e-5)
