"""Losses of classes: Eq. 5, the weights of the classes, soft IoU, Lovász-Softmax, road masks."""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from runtime.contract.contract import NO_CLASS
from training.base.processes import sum_over_processes
from training.losses.masked import grid_of, split_into_blocks

ClassWeighting = Literal["median", "sqrt_median", "paper", "none"]


def class_weights(pixel_counts: Tensor, weighting: ClassWeighting = "median") -> Tensor:
    """Return the weights beta of Eq. 5.

    Args:
        pixel_counts: (C,), pixels of each class.
        weighting: "median": median frequency over the class's own; "sqrt_median": its square root;
            "none", or without any pixel: all 1; "paper": the class's frequency, as printed, which
            favours frequent classes.

    Returns:
        float32 (C,); a class without pixels has the largest weight of the others, or 0 with
        "paper".
    """
    counts = pixel_counts.double()
    seen = counts > 0
    if weighting == "none" or not seen.any():
        return torch.ones(len(counts))
    frequency = counts / counts.sum()
    if weighting == "paper":
        return frequency.float()
    # torch.median returns the lower middle value of an even number of values; quantile the mean.
    ratio = frequency[seen].quantile(0.5) / frequency[seen]
    if weighting == "sqrt_median":
        ratio = ratio.sqrt()
    weights = ratio.max().repeat(len(counts))
    weights[seen] = ratio
    return weights.float()


def class_shares(semantic: Tensor, classes: int, grid: tuple[int, int]) -> Tensor:
    """Share of every class among the pixels under each cell of a grid: float32 (N, C, h, w).

    `semantic` int64 (N, H, W), 255 = ignore; `grid` (h, w) as in `split_into_blocks`. Pixels that
    are ignored or beyond the image have no class: the shares of a cell sum to its known part. A
    loss with these shares equals one with logits repeated over the pixels of their cell; at the
    image's size the shares are 0 and 1.
    """
    blocks, side = split_into_blocks(semantic.unsqueeze(1), grid, fill=NO_CLASS)
    pixels = F.pixel_unshuffle(blocks, side).clamp(max=classes)
    shares = torch.zeros(len(semantic), classes + 1, *grid, device=semantic.device)
    one = shares.new_tensor(1 / side**2).expand(pixels.shape)
    return shares.scatter_add_(1, pixels, one)[:, :classes]


def weighted_cross_entropy(
    log_probabilities: Tensor, shares: Tensor, weights: Tensor, sample_weight: Tensor
) -> Tensor:
    """Eq. 5: the mean of -beta log p of every known pixel's class, ().

    `log_probabilities` float (N, C, h, w); `shares` of that shape, see `class_shares`; `weights`
    float (C,) or (); `sample_weight` float (N,), see `labelled_mean`. Our reading of the
    printed beta_j: the weight of the class that pixel j is of.
    """
    of_class = (log_probabilities * shares).sum(dim=(2, 3))
    return labelled_mean(-(of_class * weights).sum(dim=1), shares.sum(), sample_weight)


def labelled_mean(sums: Tensor, known: Tensor, sample_weight: Tensor) -> Tensor:
    """Mean over the known part of the batch, ().

    `sums` float (N,) over the known part of each sample; `known` () the size of all these parts,
    in pixels or in pictures.
    `sample_weight` float (N,) scales each sample's sum but not the divisor, so a batch of labels of
    weight 0.2 gives 0.2 of the loss. 0, with a gradient of 0, if nothing is known. Samples of all
    processes count. The paper sums; a sum would outweigh the joint terms, which are means.
    """
    return sum_over_processes((sums * sample_weight).sum()) / sum_over_processes(known).clamp(
        min=1e-6
    )


def soft_iou_loss(probabilities: Tensor, shares: Tensor, sample_weight: Tensor) -> Tensor:
    """1 - mean soft IoU over the classes that the batch shows, ().

    `probabilities` float (N, C, h, w) that sum to 1 over C; `shares` of that shape, see
    `class_shares`; `sample_weight` float (N,). A differentiable IoU (Rahman and Wang 2016,
    "Optimizing intersection-over-union in deep neural networks"): thin and rare classes have the
    weight of the others, and are not predicted too often as with class weights. 0, with a gradient
    of 0, if nothing is labelled. Pixels of all processes count.
    """
    shares = shares * sample_weight[:, None, None, None]
    overlap = (probabilities * shares).sum(dim=(0, 2, 3))
    predicted = (probabilities * shares.sum(dim=1, keepdim=True)).sum(dim=(0, 2, 3))
    sums = torch.stack((overlap, predicted, shares.sum(dim=(0, 2, 3))))
    overlap, predicted, labelled = sum_over_processes(sums)
    shown = labelled > 0
    iou = overlap / (predicted + labelled - overlap).clamp(min=1e-6)
    loss: Tensor = ((1 - iou) * shown).sum() / shown.sum().clamp(min=1)
    return loss


def lovasz_softmax_loss(probabilities: Tensor, semantic: Tensor) -> Tensor:
    """Lovász-Softmax of one picture, averaged over the classes that it shows, ().

    Paper: Berman, Rannen Triki, Blaschko, "The Lovász-Softmax loss: A tractable surrogate for the
    optimization of the intersection-over-union measure in neural networks", CVPR 2018, Eq. 12: each
    pixel's error times what it adds to the Jaccard loss of the class, the largest error first.

    `probabilities` float (C, H, W) that sum to 1 over C; `semantic` int64 (H, W), 255 = ignore.
    0, with a gradient of 0, if nothing is labelled.
    """
    known = semantic != NO_CLASS
    of_class = F.one_hot(semantic[known], len(probabilities)).T.to(probabilities.dtype)  # (C, P)
    errors = (of_class - probabilities[:, known]).abs()
    errors, order = errors.sort(dim=1, descending=True)
    of_class = of_class.gather(1, order)
    area = of_class.sum(dim=1, keepdim=True)
    intersection = area - of_class.cumsum(dim=1)
    union = area + (1 - of_class).cumsum(dim=1)
    jaccard = 1 - intersection / union  # loss of the class with the first i pixels wrong; union > 0
    gain = jaccard.diff(dim=1, prepend=jaccard.new_zeros(len(jaccard), 1))
    shown = (area > 0).squeeze(1)
    loss: Tensor = ((errors * gain).sum(dim=1) * shown).sum() / shown.sum().clamp(min=1)
    return loss


# Values of a mask, see `training.datasets.sample.Sample`; any other is unknown.
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
    is_road, no_road = F.avg_pool2d(*split_into_blocks(masks, grid_of(logits))).unbind(1)
    others = torch.cat((logits[:, :road], logits[:, road + 1 :]), dim=1)
    odds = logits[:, road] - others.logsumexp(dim=1)  # log p / (1 - p)
    total = (is_road * F.softplus(-odds) + no_road * F.softplus(odds)).sum()
    return labelled_mean(total, (is_road + no_road).sum(), torch.ones_like(total))
