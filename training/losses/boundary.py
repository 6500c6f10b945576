"""Boundaries: ground truth, Eq. 6, and Eq. 7-11, which tie classes to boundaries and depth."""

from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from runtime.contract.contract import NO_CLASS
from training.base.processes import sum_over_processes
from training.losses.masked import split_into_blocks
from training.losses.semantic import labelled_mean


def boundary_target(semantic: Tensor) -> tuple[Tensor, Tensor]:
    """Return the boundary of a label map and where it is known: two bool (N, 1, H, W).

    `semantic` is int (N, H, W), 255 = ignore. A pixel is boundary if its label differs from its
    left (u - 1) or upper (v - 1) neighbour's (Eq. 7 on the ground truth), so a line is one pixel
    wide. An ignored pixel is unknown, and so is a pixel beside an ignored one, unless its other
    neighbour makes it boundary.
    """
    known = semantic != NO_CLASS
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
    """Return the boundary on a coarser grid: a cell is boundary, or known, if any pixel in it is.

    `target` and `valid` are bool (N, 1, H, W), see `boundary_target`; returns bool (N, 1, *grid).
    """
    if target.shape[-2:] == grid:
        return target, valid
    blocks, side = split_into_blocks(torch.cat((target & valid, valid), dim=1).float(), grid)
    pooled_target, pooled_valid = (F.max_pool2d(blocks, side) > 0).chunk(2, dim=1)
    return pooled_target, pooled_valid


def balanced_cross_entropy(
    logits: Tensor, target: Tensor, valid: Tensor, sample_weight: Tensor
) -> Tensor:
    """Return Eq. 6 as a mean over the known pixels: -(beta g log p + (1 - beta)(1 - g) log(1 - p)).

    `logits` are float (N, 1, H, W), and p is their sigmoid; `target` g and `valid` are bool of that
    shape; `sample_weight` is float (N,), see `labelled_mean`. In our reading, beta is the share of
    non-boundary pixels among the known ones of the whole batch, over all processes, so that the few
    boundary pixels weigh as much as all the others.
    """
    known = valid.to(logits.dtype)
    boundary = (target & valid).to(logits.dtype)
    counts = sum_over_processes(torch.stack([boundary.sum(), known.sum()]))
    share = counts[0] / counts[1].clamp(min=1)
    weight = torch.where(boundary > 0, 1 - share, share * known)
    values = F.binary_cross_entropy_with_logits(logits, boundary, weight, reduction="none")
    return labelled_mean(values.sum(dim=(1, 2, 3)), known.sum(), sample_weight)


class NeighbourMaps(NamedTuple):
    """Comparison of every pixel with its left (u - 1) and upper (v - 1) neighbour.

    Attributes:
        across: float (N, H, W - 1), horizontal; column i belongs to pixel i + 1.
        down: float (N, H - 1, W), vertical; row i belongs to pixel i + 1.
    """

    across: Tensor
    down: Tensor


class _Agreement(torch.autograd.Function):
    """sum_k p_k(u) p_k(u - 1) in both directions.

    It has its own derivative, because that of autograd would allocate the class maps for every
    slice.
    """

    @staticmethod
    def forward(ctx: Any, p: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(p)
        across = (p[..., 1:] * p[..., :-1]).sum(dim=-3)
        down = (p[..., 1:, :] * p[..., :-1, :]).sum(dim=-3)
        return across, down

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        (p,) = ctx.saved_tensors
        across, down = (gradient.unsqueeze(-3) for gradient in gradients)
        result = torch.zeros_like(p)
        result[..., 1:].addcmul_(across, p[..., :-1])
        result[..., :-1].addcmul_(across, p[..., 1:])
        result[..., 1:, :].addcmul_(down, p[..., :-1, :])
        result[..., :-1, :].addcmul_(down, p[..., 1:, :])
        return result


def soft_disagreement(probabilities: Tensor) -> NeighbourMaps:
    """1 - sum_k p_k(u) p_k(u - 1): how probably two neighbours are of different classes, 0..1.

    `probabilities` float (N, C, H, W) that sum to 1 over C. Equal to Eq. 7's indicator where p is
    one-hot, but with a gradient to the semantic head. This is our default reading of f_BS.
    """
    across, down = _Agreement.apply(probabilities)  # type: ignore[no-untyped-call]
    return NeighbourMaps(1 - across, 1 - down)


def hard_disagreement(labels: Tensor) -> NeighbourMaps:
    """Eq. 7 as printed: 1 where a label differs from its neighbour's, else 0, float32.

    `labels` int (N, H, W), arg-max of the prediction.
    """
    return NeighbourMaps(
        (labels[..., 1:] != labels[..., :-1]).float(),
        (labels[..., 1:, :] != labels[..., :-1, :]).float(),
    )


def semantic_boundary_loss(disagreement: NeighbourMaps, boundary: Tensor, *, side: int) -> Tensor:
    """Return Eq. 8: where neighbours differ in class, the boundary should be high, ().

    `boundary` is P_b, float (N, 1, H, W) in 0..1. The loss is (1/N) sum f_u e^-P_b + f_v e^-P_b
    over all N pixels; the first column and row have no neighbour, and f = 0. It needs no ground
    truth, so unlabelled images count as well. `side` is the side of a cell of the maps in pixels,
    the number of pixels along which two cells meet.
    """
    doubt = torch.exp(-boundary.squeeze(1))
    across = disagreement.across * doubt[..., 1:]
    down = disagreement.down * doubt[..., 1:, :]
    return _mean(across, down, doubt.numel() * side)


def semantic_depth_loss(disagreement: NeighbourMaps, depth: Tensor, *, side: int) -> Tensor:
    """Return Eq. 9-11: where neighbours differ in class, the depth should step, ().

    `depth` is P_d, float (N, 1, H, W). The loss is (1/N) sum f_u e^-|du P_d| + f_v e^-|dv P_d|. As
    printed it depends on the unit of depth; `SSDNetLoss` takes the normalised depth, 0..1. For
    `side` see `semantic_boundary_loss`.
    """
    depth = depth.squeeze(1)
    step_across = (depth[..., 1:] - depth[..., :-1]).abs()
    step_down = (depth[..., 1:, :] - depth[..., :-1, :]).abs()
    across = disagreement.across * torch.exp(-step_across)
    down = disagreement.down * torch.exp(-step_down)
    return _mean(across, down, depth.numel() * side)


def _mean(across: Tensor, down: Tensor, pixels: int) -> Tensor:
    """Sum both maps and divide by the number of pixels, over all processes."""
    sums = torch.stack([across.sum() + down.sum(), across.new_tensor(pixels)])
    total, count = sum_over_processes(sums).unbind()
    return total / count
