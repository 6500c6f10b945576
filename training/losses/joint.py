"""Losses that tie the tasks together: semantic-boundary, Eq. 7-8, and semantic-depth, Eq. 9-11."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from training.distributed import sum_over_processes


class NeighbourMaps(NamedTuple):
    """Comparison of every pixel with its left (u - 1) and upper (v - 1) neighbour."""

    #: float (N, H, W - 1), horizontal; column i belongs to pixel i + 1.
    across: Tensor
    #: float (N, H - 1, W), vertical; row i belongs to pixel i + 1.
    down: Tensor


class _Agreement(torch.autograd.Function):
    """sum_k p_k(u) p_k(u - 1), both ways.

    With its own derivative, because autograd's would allocate the class maps for every slice.
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


def semantic_boundary_loss(
    disagreement: NeighbourMaps, boundary: Tensor, *, side: int = 1
) -> Tensor:
    """Eq. 8: where neighbours differ in class the boundary should be high, ().

    `boundary` P_b, float (N, 1, H, W) in 0..1. (1/N) sum f_u e^-P_b + f_v e^-P_b over all N
    pixels; the first column and row have no neighbour and f = 0. Without ground truth, so that
    unlabelled images count as well. ``side`` is the side of a cell of the maps in pixels, the
    number of pixels along which two cells meet.
    """
    doubt = torch.exp(-boundary.squeeze(1))
    across = disagreement.across * doubt[..., 1:]
    down = disagreement.down * doubt[..., 1:, :]
    return _mean(across, down, doubt.numel() * side)


def semantic_depth_loss(disagreement: NeighbourMaps, depth: Tensor, *, side: int = 1) -> Tensor:
    """Eq. 9-11: where neighbours differ in class the depth should step, ().

    `depth` P_d, float (N, 1, H, W). (1/N) sum f_u e^-|du P_d| + f_v e^-|dv P_d|: the printed loss
    depends on the unit of depth; `SSDNetLoss` takes the normalised one, 0..1. ``side`` as in
    `semantic_boundary_loss`.
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
