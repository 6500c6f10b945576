"""What model.pt and best.pt hold: the averaged weights, changed as the recipe's [release] asks."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from models import Network
from runtime.checks import shown
from runtime.errors import InputError
from training.recipe import ReleaseRecipe

#: The bias of the classes' logits.
_BIAS = "semantic_head.bias"


@dataclass(frozen=True)
class Release:
    """A recipe's [release] with what it needs of the training.

    Attributes:
        recipe: the table.
        class_weights: of the semantic loss, where it has any.
        initial: the tensors that --init gave, before the first step.
    """

    recipe: ReleaseRecipe
    class_weights: Tensor | None
    initial: Mapping[str, Tensor]


def release_weights(averaged: Network, release: Release) -> Network:
    """Return the network that ships.

    First the semantic bias is lowered by ``logit_adjustment`` * log(class weight): a network
    trained with class weights w predicts the odds of w * p; subtracting log w from the logits gives
    p (Menon et al. 2021). Then the tensors that --init gave are mixed with what they became, and
    last ``logit_offsets`` are added.

    Args:
        averaged: the averaged weights of the training; not changed.
        release: the recipe's table and what it needs.
    """
    recipe, weights = release.recipe, release.class_weights
    network = copy.deepcopy(averaged)
    state = network.state_dict()
    if weights is not None and recipe.logit_adjustment:
        logs = torch.where(weights > 0, weights, 1.0).log()  # a class without weight is not changed
        state[_BIAS] = state[_BIAS] - recipe.logit_adjustment * logs.to(state[_BIAS])
    if recipe.trained_share < 1:
        for name, before in release.initial.items():
            if before.is_floating_point():  # no counts
                state[name] = torch.lerp(before.to(state[name]), state[name], recipe.trained_share)
    offsets = class_offsets(averaged, recipe.logit_offsets)
    if offsets is not None:
        state[_BIAS] = state[_BIAS] + offsets.to(state[_BIAS])
    network.load_state_dict(state)
    return network


def class_offsets(network: Network, offsets: Sequence[tuple[str, float]]) -> Tensor | None:
    """Return the offset of each class's logit, (num_classes,), or None without offsets.

    InputError for a class that the network does not have, or that is named twice.
    """
    if not offsets:
        return None
    names = [info.name for info in network.config.classes or ()]
    values = torch.zeros(len(names))
    for index, (name, offset) in enumerate(offsets):
        if name not in names or name in dict(offsets[:index]):
            raise InputError(
                f"release.logit_offsets: {shown(name)} is listed twice or is not a class of the "
                f"network; its classes are {', '.join(names) or 'none'}."
            )
        values[names.index(name)] = offset
    return values
