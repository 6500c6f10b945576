"""The optimiser, the schedule of its learning rate, and the average of the weights."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from models import Network
from runtime.errors import InputError
from training.losses import SSDNetLoss
from training.recipe import OptimizerRecipe, ScheduleRecipe

#: Arguments of AveragedModel's update rule.
Tensors = tuple[Tensor, ...] | list[Tensor]


def build_optimizer(
    recipe: OptimizerRecipe, network: Network, criterion: SSDNetLoss
) -> torch.optim.Optimizer:
    """Return AdamW or SGD over the parameters of the network and of the loss."""
    groups = parameter_groups(recipe, network, criterion)
    if recipe.name == "sgd":
        return torch.optim.SGD(groups, lr=recipe.learning_rate, momentum=recipe.momentum)
    return torch.optim.AdamW(groups, lr=recipe.learning_rate)


def parameter_groups(
    recipe: OptimizerRecipe, network: Network, criterion: SSDNetLoss
) -> list[dict[str, Any]]:
    """Return the parameters by how they are trained.

    Biases, normalisation and the parameters of the loss do not decay. The encoder may have a rate
    of its own.
    """
    separate = recipe.encoder_rate is not None
    encoder = set(require_encoder(network).parameters()) if separate else set()
    rest = [p for p in network.parameters() if p not in encoder]
    groups = _by_decay(recipe, rest, criterion.parameters())
    if encoder:
        in_order = [p for p in network.parameters() if p in encoder]
        groups += [{**group, "lr": recipe.encoder_rate} for group in _by_decay(recipe, in_order)]
    return groups


def require_encoder(network: Network) -> nn.Module:
    """Return the network's encoder; InputError if it has none."""
    encoder = dict(network.named_children()).get("encoder")
    if encoder is None:
        raise InputError(
            f"optimizer.encoder_rate: '{network.config.name}' has no part called 'encoder'. Leave "
            "it out, or take ssdnet-lite or ssdnet-nano."
        )
    return encoder


def _by_decay(
    recipe: OptimizerRecipe, parameters: Sequence[nn.Parameter], others: Iterable[nn.Parameter] = ()
) -> list[dict[str, Any]]:
    kernels = [p for p in parameters if p.ndim > 1]
    vectors = [p for p in parameters if p.ndim <= 1]
    return [
        {"params": kernels, "weight_decay": recipe.weight_decay},
        {"params": [*vectors, *others], "weight_decay": 0.0},
    ]


def learning_rate(schedule: ScheduleRecipe, peak: float, step: int) -> float:
    """Return the rate of a step: linear warm-up from peak / warmup_steps, then the schedule."""
    if step < schedule.warmup_steps:
        return peak * (step + 1) / schedule.warmup_steps
    if schedule.shape == "constant":
        return peak
    progress = (step - schedule.warmup_steps) / max(1, schedule.steps - schedule.warmup_steps)
    share = 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
    return peak * share


def exponential_average(decay: float) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """Return AveragedModel's update rule: an exponential average.

    The decay grows as (1 + n) / (10 + n) up to ``decay``, so that the random initial weights do not
    remain in the average of a short run.
    """

    @torch.no_grad()
    def update(average: Tensors, current: Tensors, count: Tensor | int) -> None:
        share = 1.0 - min(decay, (1.0 + int(count)) / (10.0 + int(count)))
        if average[0].is_floating_point():
            torch._foreach_lerp_(average, current, share)
        else:  # counters
            torch._foreach_copy_(average, current)

    return update
