"""The loss of the new head."""

import torch.nn.functional as F
from torch import Tensor

from training.losses.semantic import labelled_mean
from training.losses.terms import head_term


def drivable_loss(logits: Tensor, labels: Tensor, weights: Tensor) -> Tensor:
    """Return the mean cross-entropy over the labelled pixels, (); see `HeadLoss`."""
    known = ~labels.isnan()
    errors = F.binary_cross_entropy_with_logits(logits[:, 0], labels.nan_to_num(), reduction="none")
    return labelled_mean((errors * known).sum(dim=(1, 2)), known.sum(), weights)


LOSS = head_term("drivable", drivable_loss)
