"""Eq. 7-11 against plain loops and cases by hand."""

import math

import numpy as np
import pytest
import torch

from training.losses.boundary import (
    hard_disagreement,
    semantic_boundary_loss,
    semantic_depth_loss,
    soft_disagreement,
)


def joint_losses_by_loops(probabilities, boundary, depth, depth_scale, *, soft):
    """Eq. 8 and 11 as sums over (u, v), divided by N."""
    count, classes, height, width = probabilities.shape
    with_boundary = with_depth = 0.0

    def disagreement(a, b):
        if soft:
            return 1 - sum(a[k] * b[k] for k in range(classes))
        return float(a.argmax() != b.argmax())

    for n, v, u in np.ndindex(count, height, width):
        here = probabilities[n, :, v, u]
        p_b = boundary[n, 0, v, u]
        p_d = depth[n, 0, v, u]
        for dv, du in ((0, 1), (1, 0)):
            if v < dv or u < du:
                continue
            f = disagreement(here, probabilities[n, :, v - dv, u - du])
            step = abs(p_d - depth[n, 0, v - dv, u - du])
            with_boundary += f * math.exp(-p_b)
            with_depth += f * math.exp(-depth_scale * step)
    pixels = count * height * width
    return with_boundary / pixels, with_depth / pixels


@pytest.mark.parametrize("soft", [True, False])
def test_joint_losses_equal_loops(soft):
    rng = np.random.default_rng(0)
    logits = torch.from_numpy(rng.standard_normal((2, 3, 5, 6)))
    probabilities = torch.softmax(2 * logits, dim=1)
    boundary = torch.from_numpy(rng.random((2, 1, 5, 6)))
    depth = torch.from_numpy(rng.random((2, 1, 5, 6)))
    maps = (
        soft_disagreement(probabilities) if soft else hard_disagreement(probabilities.argmax(dim=1))
    )
    expected = joint_losses_by_loops(
        probabilities.numpy(), boundary.numpy(), depth.numpy(), 7.0, soft=soft
    )
    for side in (1, 2):  # cells of two pixels meet along two
        ours = (
            semantic_boundary_loss(maps, boundary, side=side).item(),
            semantic_depth_loss(maps, 7.0 * depth, side=side).item(),
        )
        assert ours == pytest.approx([value / side for value in expected], rel=1e-6)
