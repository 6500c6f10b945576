"""The loss of one class against a mask of it: road or not road."""

import torch
import torch.nn.functional as F
from torch import Tensor

from training.distributed import sum_over_processes
from training.losses.masked import split_into_blocks

#: Values of a mask, see `training.datasets.sample.Sample`; any other is unknown.
NO_ROAD, ROAD = 0, 1


def road_loss(logits: Tensor, road_mask: Tensor, road: int) -> Tensor:
    """Binary cross-entropy of one class, a mean over the known pixels, ().

    -log p of the class `road` where the mask is `ROAD`, -log(1 - p) where it is `NO_ROAD`; the
    ratios among the other classes have no gradient.

    `logits` float (N, C, h, w) of all classes, C > 1, at the image's size or on a coarser grid, on
    which every pixel counts in its cell; `road_mask` uint8 (N, H, W). 0, with a gradient of 0, if
    no pixel is known. Pixels of all processes count.
    """
    masks = torch.stack((road_mask == ROAD, road_mask == NO_ROAD), dim=1).to(logits.dtype)
    blocks, side = split_into_blocks(masks, (logits.shape[-2], logits.shape[-1]))
    is_road, no_road = (F.avg_pool2d(blocks, side) if side > 1 else blocks).unbind(1)
    others = torch.cat((logits[:, :road], logits[:, road + 1 :]), dim=1)
    odds = logits[:, road] - others.logsumexp(dim=1)  # log p / (1 - p)
    total = (is_road * F.softplus(-odds) + no_road * F.softplus(odds)).sum()
    known = (is_road + no_road).sum()
    return sum_over_processes(total) / sum_over_processes(known).clamp(min=1e-6)
