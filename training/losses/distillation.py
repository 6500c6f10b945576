"""Losses of a network that learns the answers of a teacher network (Hinton et al. 2015).

They need no labels: every pixel of every picture counts. The teacher has seen the same inputs.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from training.losses.depth import log_ratio
from training.losses.masked import grid_of, masked_mean, on_grid

# Scale of the teacher's error, as a share of its depth, at which a pixel counts half.
HALF_CERTAIN = 0.05


def distilled_semantic_loss(logits: Tensor, teacher: Tensor) -> Tensor:
    """Kullback-Leibler divergence of the classes from the teacher's, mean over cells, ().

    logits, teacher: (N, C, h, w), on different grids; compared on the grid of `logits`.
    """
    wanted = on_grid(teacher.softmax(dim=1), grid_of(logits))
    divergence = F.kl_div(logits.log_softmax(dim=1), wanted, reduction="none")
    return _mean(divergence.sum(dim=1, keepdim=True))


def distilled_depth_loss(depth: Tensor, teacher: Tensor, scale: Tensor | None) -> Tensor:
    """Mean |log ratio| to the teacher's depth, less where it is uncertain, ().

    depth, teacher: (N, 1, H, W), normalised, at the image's size. scale: of the teacher's error,
    see `NetworkOutput.depth_uncertainty`; None: all pixels count alike.
    """
    difference = log_ratio(depth, teacher).abs()
    if scale is not None:
        difference = difference * teacher / (teacher + scale / HALF_CERTAIN)
    return _mean(difference)


def distilled_boundary_loss(logits: Tensor, teacher: Tensor) -> Tensor:
    """Mean cross-entropy of the boundary's probability with the teacher's, ().

    logits, teacher: (N, 1, h, w), on different grids; compared on the grid of `logits`.
    """
    wanted = on_grid(torch.sigmoid(teacher), grid_of(logits))
    return _mean(F.binary_cross_entropy_with_logits(logits, wanted, reduction="none"))


def _mean(values: Tensor) -> Tensor:
    """Mean over (N, 1, h, w) of all processes, ()."""
    return masked_mean(values, torch.ones_like(values, dtype=torch.bool))
