"""Class-weighted cross-entropy, Eq. 5, the weights of the classes, and soft IoU."""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from training.distributed import sum_over_processes
from training.losses.masked import cell_side

IGNORE = 255

ClassWeighting = Literal["median", "sqrt_median", "paper", "none"]


def class_weights(pixel_counts: Tensor, weighting: ClassWeighting = "median") -> Tensor:
    """Return the weights beta of Eq. 5.

    Args:
        pixel_counts: (C,), pixels of each class.
        weighting: "median": median frequency over the class's own; "sqrt_median": its square root;
            "none": all 1; "paper": the class's frequency, as printed, which favours frequent
            classes.

    Returns:
        float32 (C,); a class without pixels has the largest weight of the others, or 0 with
        "paper".

    Raises:
        ValueError: if no pixel was counted.
    """
    counts = pixel_counts.double()
    seen = counts > 0
    if not seen.any():
        raise ValueError("no labelled pixel was counted, so there are no class frequencies")
    if weighting == "none":
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
    height, width = semantic.shape[-2:]
    side = cell_side((height, width), grid)
    padding = (0, side * grid[1] - width, 0, side * grid[0] - height)
    pixels = F.pad(semantic, padding, value=IGNORE) if any(padding) else semantic
    pixels = F.pixel_unshuffle(pixels.unsqueeze(1), side).clamp(max=classes)
    shares = torch.zeros(len(semantic), classes + 1, *grid, device=semantic.device)
    one = shares.new_tensor(1 / side**2).expand(pixels.shape)
    return shares.scatter_add_(1, pixels, one)[:, :classes]


def cross_entropy_sums(log_probabilities: Tensor, shares: Tensor, weights: Tensor) -> Tensor:
    """Eq. 5 summed over each sample, -beta log p of every known pixel's class: (N,), in cells.

    `log_probabilities` float (N, C, h, w); `shares` of that shape, see `class_shares`; `weights`
    float (C,). Our reading of the printed beta_j: the weight of the class that pixel j is of.
    """
    of_class = (log_probabilities * shares).sum(dim=(2, 3))
    return -(of_class * weights).sum(dim=1)


def labelled_mean(sums: Tensor, known: Tensor, sample_weight: Tensor | None = None) -> Tensor:
    """Mean over the known part of the batch, ().

    `sums` float (N,) over the known part of each sample; `known` () the size of all these parts.
    `sample_weight` float (N,) scales each sample's sum but not the divisor, so a batch of labels of
    weight 0.2 gives 0.2 of the loss. 0, with a gradient of 0, if nothing is known. Samples of all
    processes count. The paper sums; a sum would outweigh the joint terms, which are means.
    """
    if sample_weight is not None:
        sums = sums * sample_weight
    return sum_over_processes(sums.sum()) / sum_over_processes(known).clamp(min=1e-6)


def soft_overlap(
    probabilities: Tensor, shares: Tensor, sample_weight: Tensor | None = None
) -> Tensor:
    """The parts of soft IoU, summed over all labelled pixels: float (3, C), in cells.

    `probabilities` float (N, C, h, w) that sum to 1 over C; `shares` of that shape, see
    `class_shares`; `sample_weight` float (N,). Rows: probability on pixels of the class
    (intersection), probability on all labelled pixels, pixels of the class. Rows of parts of a
    batch add up.
    """
    if sample_weight is not None:
        shares = shares * sample_weight[:, None, None, None]
    intersection = (probabilities * shares).sum(dim=(0, 2, 3))
    predicted = (probabilities * shares.sum(dim=1, keepdim=True)).sum(dim=(0, 2, 3))
    return torch.stack((intersection, predicted, shares.sum(dim=(0, 2, 3))))


def soft_iou_loss(overlap: Tensor) -> Tensor:
    """1 - mean soft IoU over the classes that the batch shows, ().

    `overlap` (3, C), see `soft_overlap`. A differentiable IoU (Rahman and Wang 2016, "Optimizing
    intersection-over-union in deep neural networks"): thin and rare classes have the weight of the
    others, and are not predicted too often as with class weights. 0, with a gradient of 0, if
    nothing is labelled. Pixels of all processes count.
    """
    intersection, predicted, labelled = sum_over_processes(overlap)
    shown = labelled > 0
    iou = intersection / (predicted + labelled - intersection).clamp(min=1e-6)
    loss: Tensor = ((1 - iou) * shown).sum() / shown.sum().clamp(min=1)
    return loss
