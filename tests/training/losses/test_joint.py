"""Eq. 7-11 as printed."""

import numpy as np
import pytest
import torch

from training.losses.boundary import (
    hard_disagreement,
    semantic_boundary_loss,
    semantic_depth_loss,
    soft_disagreement,
)


def joint_losses_as_printed(probabilities, boundary, depth, *, soft):
    """Eq. 8 and 11 as sums over the neighbours in each direction, divided by N."""
    with_boundary = with_depth = 0.0
    for axis in (2, 3):
        now, last = ((slice(None),) * axis + (part,) for part in (np.s_[1:], np.s_[:-1]))
        f = 1 - (probabilities[now] * probabilities[last]).sum(axis=1, keepdims=True)
        if not soft:
            labels = probabilities.argmax(axis=1, keepdims=True)
            f = labels[now] != labels[last]
        with_boundary += (f * np.exp(-boundary[now])).sum()
        with_depth += (f * np.exp(-np.abs(depth[now] - depth[last]))).sum()
    return with_boundary / boundary.size, with_depth / boundary.size


@pytest.mark.parametrize("soft", [True, False])
def test_joint_losses_are_those_of_the_paper(soft):
    rng = np.random.default_rng(0)
    probabilities = torch.softmax(torch.from_numpy(2 * rng.standard_normal((2, 3, 5, 6))), dim=1)
    boundary, depth = torch.from_numpy(rng.random((2, 2, 1, 5, 6)))
    labels = probabilities.argmax(dim=1)
    maps = soft_disagreement(probabilities) if soft else hard_disagreement(labels)
    arrays = (probabilities.numpy(), boundary.numpy(), 7.0 * depth.numpy())
    expected = joint_losses_as_printed(*arrays, soft=soft)
    for side in (1, 2):  # cells of two pixels meet along two
        ours = (
            semantic_boundary_loss(maps, boundary, side=side).item(),
            semantic_depth_loss(maps, 7.0 * depth, side=side).item(),
        )
        assert ours == pytest.approx([value / side for value in expected], rel=1e-6)
