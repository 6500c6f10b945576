"""Changes of trained weights before they are used; each function returns another network."""

import copy
from collections.abc import Mapping

import torch
from pydantic.dataclasses import dataclass
from torch import Tensor

from models import Network
from runtime.base.arguments import shown
from runtime.base.errors import InputError
from training.base.limits import STRICT, Share

# The bias of the classes' logits.
_BIAS = "semantic_head.bias"


@dataclass(frozen=True, config=STRICT)
class ReleaseRecipe:
    """How the weights in model.pt and best.pt differ from the averaged ones.

    Attributes:
        logit_adjustment: share of the log class weights that is subtracted from the semantic bias
            (Menon et al. 2021), because training with class weights predicts rare classes too
            often. 0: nothing, 1: all.
    """

    logit_adjustment: Share = 0.0


def adjust_logits(network: Network, class_weights: Tensor, share: float) -> Network:
    """Lower the semantic bias by `share` * log(class weight) (Menon et al. 2021).

    A network trained with class weights w predicts the odds of w * p; subtracting log w from the
    logits gives p. Without a share or classes the network itself is returned.
    """
    if not share or "semantic" not in network.heads:
        return network
    # A class without weight is not changed.
    return _with_bias(network, -share * torch.where(class_weights > 0, class_weights, 1.0).log())


def mix_weights(before: Network, after: Network, share: float) -> Network:
    """Return the weights between those before and after a training (Wortsman et al. 2022, WiSE-FT).

    A little training on new data then keeps what the old weights knew.

    Args:
        before: the network with which the training began.
        after: the trained network, with the same configuration.
        share: share of the trained weights, 0..1.

    Raises:
        InputError: if the configurations differ.
    """
    if before.config != after.config:
        raise InputError(
            "weights before and after the training are not of one network: train without changes "
            "of [model]"
        )
    old, mixed = before.state_dict(), copy.deepcopy(after)
    state = mixed.state_dict()
    for name, value in state.items():
        if value.is_floating_point():  # no counts
            state[name] = torch.lerp(old[name].to(value), value, share)
    mixed.load_state_dict(state)
    return mixed


def add_offsets(network: Network, offsets: Mapping[str, float]) -> Network:
    """Add to the logit of each class in `offsets`; benchmarks/logit_offsets.py finds them.

    Raises:
        InputError: for a class that the network does not have.
    """
    names = [info.name for info in network.config.classes]
    if unknown := [name for name in offsets if name not in names]:
        raise InputError(
            f"offsets of logits: {shown(unknown[0])} is not a class of the network: name some of "
            f"its classes, {', '.join(names) or 'none'}"
        )
    return _with_bias(network, torch.tensor([offsets.get(name, 0.0) for name in names]))


def _with_bias(network: Network, change: Tensor) -> Network:
    """Return a copy of the network with a change, (num_classes,), added to its semantic bias."""
    changed = copy.deepcopy(network)
    if rows := network.config.class_rows:
        change = change.repeat_interleave(torch.tensor(rows))
    state = changed.state_dict()
    state[_BIAS] = state[_BIAS] + change.to(state[_BIAS])
    changed.load_state_dict(state)
    return changed
