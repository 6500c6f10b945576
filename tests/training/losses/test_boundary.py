"""Boundary ground truth and Eq. 6 against plain loops and cases by hand."""

import math

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


def cross_entropy_by_loops(logits, target, valid, sample_weight):
    beta = int((valid & ~target).sum()) / int(valid.sum())
    total, count = 0.0, 0
    for n in range(len(logits)):
        for v, u in np.ndindex(*logits.shape[2:]):
            if not valid[n, 0, v, u]:
                continue
            p = 1 / (1 + math.exp(-logits[n, 0, v, u]))
            g = target[n, 0, v, u]
            entropy = beta * math.log(p) if g else (1 - beta) * math.log(1 - p)
            total -= sample_weight[n] * entropy
            count += 1
    return total / count


def test_balanced_cross_entropy_equals_loops():
    rng = np.random.default_rng(1)
    logits = rng.standard_normal((2, 1, 6, 7)).astype(np.float32)
    target = rng.random((2, 1, 6, 7)) < np.array([0.1, 0.4]).reshape(2, 1, 1, 1)
    valid = rng.random((2, 1, 6, 7)) < 0.8
    sample_weight = np.array([0.3, 1.0], dtype=np.float32)
    ours = balanced_cross_entropy(
        torch.from_numpy(logits),
        torch.from_numpy(target),
        torch.from_numpy(valid),
        torch.from_numpy(sample_weight),
    )
    expected = cross_entropy_by_loops(logits, target, valid, sample_weight)
    assert ours.item() == pytest.approx(expected, rel=1e-5)
