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
    """Weights beta of Eq. 5 from how many pixels each class has: float32 (C,).

    `pixel_counts` (C,), >= 0. "median": median frequency over the class's own; "sqrt_median": its
    square root, a gentler one; "none": all 1; "paper": the class's proportion, literally as
    printed, which favours the frequent classes. A class never seen gets the largest weight of the
    others, or 0 from "paper". Raises ValueError if no pixel was counted at all.
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
    # quantile and not median: of an even count the latter takes the lower of the two middle ones.
    ratio = frequency[seen].quantile(0.5) / frequency[seen]
    if weighting == "sqrt_median":
        ratio = ratio.sqrt()
    weights = ratio.max().repeat(len(counts))
    weights[seen] = ratio
    return weights.float()


def class_shares(semantic: Tensor, classes: int, grid: tuple[int, int]) -> Tensor:
    """Share of every class among the pixels under each cell of a grid: float32 (N, C, h, w).

    `semantic` int64 (N, H, W), 255 = ignore; `grid` (h, w) as in `split_into_blocks`. Pixels that
    are ignored or beyond the image are of no class: the shares of a cell sum to the known part of
    it. Logits scored with them count as if they were repeated over all pixels of their cell; at
    the size of the image the shares are 0 and 1.
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
    """Mean over all that is known in the batch, ().

    `sums` float (N,) over what is known of each sample; `known` (): how much that is altogether.
    `sample_weight` float (N,) scales each sample's part without changing what is divided by, so a
    batch of labels worth 0.2 gives 0.2 of the loss. 0, with a gradient of 0, if nothing is known.
    What all processes know counts. The paper sums; a sum would drown the joint terms, which are
    means.
    """
    if sample_weight is not None:
        sums = sums * sample_weight
    return sum_over_processes(sums.sum()) / sum_over_processes(known).clamp(min=1e-6)


def soft_overlap(
    probabilities: Tensor, shares: Tensor, sample_weight: Tensor | None = None
) -> Tensor:
    """What soft IoU is made of, summed over all labelled pixels: float (3, C), in cells.

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

    `overlap` (3, C), see `soft_overlap`. The measure that cross-entropy stands in for, made
    differentiable (Rahman and Wang 2016, "Optimizing intersection-over-union in deep neural
    networks"): thin and rare classes count like the others, without being found too often as
    class weights make them. 0, with a gradient of 0, if nothing is labelled. Pixels of all
    processes count.
    """
    intersection, predicted, labelled = sum_over_processes(overlap)
    shown = labelled > 0
    iou = intersection / (predicted + labelled - intersection).clamp(min=1e-6)
    loss: Tensor = ((1 - iou) * shown).sum() / shown.sum().clamp(min=1)
    return loss
