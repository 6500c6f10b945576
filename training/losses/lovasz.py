"""The Lovász-Softmax loss: a surrogate of mean IoU on probabilities."""

from torch import Tensor
from torch.nn import functional as F

from training.distributed import sum_over_processes
from training.losses.semantic import IGNORE


def lovasz_softmax_loss(probabilities: Tensor, semantic: Tensor) -> Tensor:
    """Lovász-Softmax of one picture, averaged over the classes that it shows, ().

    Paper: Berman, Rannen Triki, Blaschko, "The Lovász-Softmax loss: A tractable surrogate for the
    optimization of the intersection-over-union measure in neural networks", CVPR 2018, Eq. 12: each
    pixel's error times what it adds to the Jaccard loss of the class, the largest error first.

    `probabilities` float (C, H, W) that sum to 1 over C; `semantic` int64 (H, W), 255 = ignore.
    0, with a gradient of 0, if nothing is labelled.
    """
    known = semantic != IGNORE
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


def picture_mean(losses: Tensor, known: Tensor, sample_weight: Tensor | None = None) -> Tensor:
    """Mean over the pictures of the batch that have a label, ().

    `losses` float (N,); `known` bool (N, H, W), the labelled pixels; `sample_weight` float (N,)
    scales each without changing what is divided by. 0, with a gradient of 0, if nothing is known.
    Pictures of all processes count.
    """
    if sample_weight is not None:
        losses = losses * sample_weight
    labelled = known.flatten(1).any(dim=1).sum()
    return sum_over_processes(losses.sum()) / sum_over_processes(labelled).clamp(min=1)
