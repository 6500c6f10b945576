"""Boundary ground truth, Eq. 7 on the labels, and class-balanced cross-entropy, Eq. 6."""

import torch
import torch.nn.functional as F
from torch import Tensor

from training.distributed import sum_over_processes
from training.losses.masked import split_into_blocks
from training.losses.semantic import IGNORE, labelled_mean


def boundary_target(semantic: Tensor) -> tuple[Tensor, Tensor]:
    """Boundary of a label map and where it is known: two bool (N, 1, H, W).

    `semantic` int (N, H, W), 255 = ignore. A pixel is boundary if its label differs from its left
    (u - 1) or upper (v - 1) neighbour's, Eq. 7 on the ground truth, so a line is one pixel wide.
    An ignored pixel is unknown, and so is a pixel beside an ignored one, unless its other neighbour
    makes it boundary.
    """
    known = semantic != IGNORE
    target = torch.zeros_like(known)
    decided = known.clone()
    for now, before in (
        ((..., slice(1, None)), (..., slice(None, -1))),
        ((..., slice(1, None), slice(None)), (..., slice(None, -1), slice(None))),
    ):
        target[now] |= (semantic[now] != semantic[before]) & known[now] & known[before]
        decided[now] &= known[before]
    return target.unsqueeze(1), (decided | target).unsqueeze(1)


def boundary_at_scale(
    target: Tensor, valid: Tensor, grid: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Boundary on a coarser grid: a cell is boundary if any pixel in it is, and known likewise.

    `target`, `valid` bool (N, 1, H, W), see `boundary_target`; returns bool (N, 1, *grid).
    """
    if target.shape[-2:] == grid:
        return target, valid
    blocks, side = split_into_blocks(torch.cat((target & valid, valid), dim=1).float(), grid)
    pooled_target, pooled_valid = (F.max_pool2d(blocks, side) > 0).chunk(2, dim=1)
    return pooled_target, pooled_valid


def balanced_cross_entropy(
    logits: Tensor,
    target: Tensor,
    valid: Tensor,
    *,
    sample_weight: Tensor | None = None,
) -> Tensor:
    """Eq. 6 as a mean over the known pixels: -(beta g log p + (1 - beta)(1 - g) log(1 - p)), ().

    `logits` float (N, 1, H, W), p is their sigmoid; `target` g and `valid` bool of that shape;
    `sample_weight` float (N,), see `labelled_mean`. Our reading: beta is the share of non-boundary
    pixels among the known ones of the whole batch, of all processes, so that the few boundary
    pixels weigh as much as all the others.
    """
    known = valid.to(logits.dtype)
    boundary = (target & valid).to(logits.dtype)
    counts = sum_over_processes(torch.stack([boundary.sum(), known.sum()]))
    share = counts[0] / counts[1].clamp(min=1)
    weight = torch.where(boundary > 0, 1 - share, share * known)
    values = F.binary_cross_entropy_with_logits(logits, boundary, weight, reduction="none")
    return labelled_mean(values.sum(dim=(1, 2, 3)), known.sum(), sample_weight)
