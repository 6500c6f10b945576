"""Losses that need no labels: agreement of two shifted views, and with a teacher's answers.

The views of one frame must agree where they overlap. A network that learns from a teacher
(Hinton et al. 2015) sees the same inputs as the teacher has seen, and every pixel counts.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from models.pooling import window_maxima
from training.base.processes import sum_over_processes
from training.loading.augment_config import PAIR_BORDER_PX
from training.loading.batch import Pair
from training.losses.depth import log_ratio
from training.losses.masked import grid_of, masked_mean, on_grid

# Weights of the depth's log ratio at pixels farther than NEAR_PX from a return, and nearer.
FAR_WEIGHT, NEAR_WEIGHT = 1.2, 0.2
NEAR_PX = 6
# The upper edge of the scan is the highest return within this many columns.
EDGE_COLUMNS = 17
# Distance in rows over which a jump of the depth is measured.
STEP_ROWS = 8
# Scale of the teacher's error, as a share of its depth, at which a pixel counts half.
HALF_CERTAIN = 0.05


def overlap(
    first: Tensor, second: Tensor, offset: tuple[int, int], *, side: int = 1
) -> tuple[Tensor, Tensor]:
    """Crop two maps to the area that both views show, without PAIR_BORDER_PX: two (C, h', w').

    Args:
        first: (C, h, w), a map of cells of `side` pixels.
        second: a map of the same shape for the second view.
        offset: rows and columns [px] of the second view's upper left corner in the first view,
            multiples of `side`.
        side: side of a cell in pixels.
    """
    border = -(-PAIR_BORDER_PX // side)
    rows, columns = (part // side for part in offset)
    height, width = first.shape[-2] - rows - 2 * border, first.shape[-1] - columns - 2 * border
    top, left = rows + border, columns + border
    return (
        first[:, top : top + height, left : left + width],
        second[:, border : border + height, border : border + width],
    )


def depth_consistency_loss(first: Tensor, second: Tensor, pair: Pair) -> Tensor:
    """Mean |log ratio| of the depth of the two views, weighted by the distance to a return, ().

    first, second: (N, 1, H, W), normalised depth at the image's size. A frame does not count if
    only one view has LiDAR input. If the LiDAR inputs of both views differ (one has false returns),
    all pixels have FAR_WEIGHT, because false returns must not change the depth around them.
    """
    near = window_maxima((pair.first_lidar > 0).to(first.dtype), 2 * NEAR_PX + 1)
    losses = []
    for index, offset in enumerate(pair.offset.tolist()):
        maps = (pair.first_lidar[index], pair.second_lidar[index])
        if bool(maps[0].any()) != bool(maps[1].any()):
            continue
        lidar, other = overlap(*maps, offset)
        ratio = log_ratio(*overlap(first[index], second[index], offset)).abs()
        close = overlap(near[index], near[index], offset)[0] * (NEAR_WEIGHT - FAR_WEIGHT)
        weight = FAR_WEIGHT + close * float(torch.equal(lidar, other))
        losses.append((ratio * weight).mean())
    return _mean_over_frames(losses, first)


def depth_seam_loss(first: Tensor, second: Tensor, pair: Pair) -> Tensor:
    """Penalise a jump of the depth at the upper edge of the scan, ().

    A prediction that follows the returns may jump where they end; a prediction from the camera
    alone does not. Only frames count of which one view has returns and the other has none. The loss
    is the mean absolute difference between the two views in the change of log depth over STEP_ROWS
    across the edge, in columns with a return. The view without returns gets no gradient.

    first, second: as in `depth_consistency_loss`.
    """
    losses = []
    for index, offset in enumerate(pair.offset.tolist()):
        lidars = overlap(pair.first_lidar[index], pair.second_lidar[index], offset)
        answers = overlap(first[index], second[index], offset)
        if bool(lidars[0].any()) == bool(lidars[1].any()):
            continue
        fused = 0 if lidars[0].any() else 1
        ratio = log_ratio(answers[fused], answers[1 - fused].detach())
        window, padding = (1, EDGE_COLUMNS), (0, EDGE_COLUMNS // 2)
        returns = F.max_pool2d((lidars[fused] > 0).to(ratio.dtype), window, 1, padding)
        scanned = returns.cummax(dim=1).values  # from the scan's upper edge downwards
        counted = (1 - scanned[:, :-STEP_ROWS]) * scanned[:, -1:]
        jumps = (ratio[:, :-STEP_ROWS] - ratio[:, STEP_ROWS:]).abs() * counted
        losses.append(jumps.sum() / counted.sum().clamp(min=1))
    return _mean_over_frames(losses, first)


def semantic_consistency_loss(first: Tensor, second: Tensor, pair: Pair, *, side: int) -> Tensor:
    """Symmetric Kullback-Leibler divergence of the classes of the two views, mean over cells, ().

    first, second: (N, C, h, w), logits on cells of `side` pixels.
    """
    losses = []
    for index, offset in enumerate(pair.offset.tolist()):
        logs = [
            view.log_softmax(dim=0)
            for view in overlap(first[index], second[index], offset, side=side)
        ]
        difference = logs[0] - logs[1]
        losses.append(((logs[0].exp() - logs[1].exp()) * difference).sum(dim=0).mean())
    return _mean_over_frames(losses, first)


def _mean_over_frames(losses: list[Tensor], views: Tensor) -> Tensor:
    """Mean of the frames' losses over all processes, (); without losses 0, with a gradient of 0."""
    total = torch.stack(losses).sum() if losses else views.sum() * 0.0
    count = sum_over_processes(total.new_tensor(len(losses)))
    return sum_over_processes(total) / count.clamp(min=1)


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
