"""Class-weighted cross-entropy, Eq. 5, the weights of the classes, and soft IoU."""

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from training.distributed import sum_over_processes

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


def cross_entropy_map(log_probabilities: Tensor, semantic: Tensor, weights: Tensor) -> Tensor:
    """One pixel's term of Eq. 5, -beta log p of its class: float (N, H, W), 0 where ignored.

    `log_probabilities` float (N, C, H, W); `semantic` int64 (N, H, W), 255 = ignore; `weights`
    float (C,). Our reading of the printed beta_j: the weight of the class that pixel j is of.
    """
    return F.nll_loss(
        log_probabilities, semantic, weight=weights, ignore_index=IGNORE, reduction="none"
    )


def labelled_mean(values: Tensor, known: Tensor, sample_weight: Tensor | None = None) -> Tensor:
    """Mean over all known pixels of the batch, ().

    `values` float (N, H, W), 0 where not `known`, bool (N, H, W). `sample_weight` float (N,)
    scales each sample's part without changing what is divided by, so a batch of labels worth 0.2
    gives 0.2 of the loss. 0, with a gradient of 0, if nothing is known. Pixels of all processes
    count.
    """
    sums = values.sum(dim=(1, 2))
    if sample_weight is not None:
        sums = sums * sample_weight
    return sum_over_processes(sums.sum()) / sum_over_processes(known.sum()).clamp(min=1)


def weighted_cross_entropy(
    log_probabilities: Tensor,
    semantic: Tensor,
    weights: Tensor,
    sample_weight: Tensor | None = None,
) -> Tensor:
    """Eq. 5 as a mean over the labelled pixels, (). Arguments as the two functions above.

    The paper sums; a sum would drown the joint terms, which are means.
    """
    values = cross_entropy_map(log_probabilities, semantic, weights)
    return labelled_mean(values, semantic != IGNORE, sample_weight)


def soft_overlap(
    probabilities: Tensor, semantic: Tensor, sample_weight: Tensor | None = None
) -> Tensor:
    """What soft IoU is made of, summed over all labelled pixels: float (3, C).

    `probabilities` float (N, C, H, W) that sum to 1 over C; `semantic` int64 (N, H, W), 255 =
    ignore; `sample_weight` float (N,). Rows: probability on pixels of the class (intersection),
    probability on all labelled pixels, pixels of the class. Rows of parts of a batch add up.
    """
    classes = probabilities.shape[1]
    known = semantic != IGNORE
    weight = known.to(probabilities.dtype)
    if sample_weight is not None:
        weight = weight * sample_weight[:, None, None]
    predicted = torch.einsum("nchw,nhw->c", probabilities, weight)
    label = torch.where(known, semantic, 0)
    right = probabilities.gather(1, label[:, None]).squeeze(1) * weight
    empty = probabilities.new_zeros(classes)
    intersection = empty.index_add(0, label.flatten(), right.flatten())
    labelled = empty.index_add(0, label.flatten(), weight.flatten())
    return torch.stack((intersection, predicted, labelled))


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
