"""Losses of heads that the paper does not have: one row a head."""

from collections.abc import Callable

from torch import Tensor

#: (answer of the network (N, 1, H, W), labels (N, H, W), weight of each frame's labels (N,)) ->
#: loss (), a mean over the labelled pixels of all processes, see `training.losses.semantic`.
HeadLoss = Callable[[Tensor, Tensor, Tensor], Tensor]

#: Head, a name in `NetworkOutput.others` -> its loss. The target has the same name.
HEAD_LOSSES: dict[str, HeadLoss] = {}
