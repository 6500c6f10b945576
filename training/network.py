"""The network of a recipe: built, initialised, and its semantic bias adjusted."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models import Network, NetworkConfig, create_model
from models.registry import NETWORKS
from runtime.errors import InputError
from training.datasets.class_mapping import list_classes
from training.initial_weights import start_from
from training.recipe import ModelRecipe


def build_network(recipe: ModelRecipe, init: Path | None) -> Network:
    """Build a recipe's network, with the weights of the checkpoint ``init`` as far as they fit.

    Raises:
        InputError: if the network cannot be built.
        CheckpointError: if ``init`` cannot be read or nothing of it fits.
    """
    # Only what the recipe changes: not every network has these fields.
    changes: dict[str, Any] = {}
    if not recipe.boundary_gating:
        changes["boundary_gating"] = False
    if recipe.sparse_depth_gain != 1:
        changes["sparse_depth_gain"] = recipe.sparse_depth_gain
    if recipe.canonical_focal_px is not None:
        changes["canonical_focal_px"] = recipe.canonical_focal_px
    try:
        if recipe.name in NETWORKS:
            config = _configuration(NETWORKS[recipe.name].config, recipe.config)
            changes |= {key: getattr(config, key) for key in recipe.config}
            changes["classes"] = list_classes(recipe.class_table) if config.classes else ()
        network = create_model(recipe.name, max_depth_m=recipe.max_depth_m, **changes)
    except ValueError as error:
        raise InputError(f"the recipe's model cannot be built: {error}.") from error
    if init is not None:
        start_from(network, init)
    return network


def _configuration(config: NetworkConfig, changes: Mapping[str, Any]) -> NetworkConfig:
    """Change fields of a configuration; without a semantic head there are no classes."""
    values = {**config.to_dict(), **changes}
    if changes.get("semantic_head") is False:
        values["classes"] = ()
    return type(config).from_dict(values)


def train_parts(network: Network, only: tuple[str, ...]) -> None:
    """Put the parts whose names begin with one of ``only`` into training mode; () = all.

    The others are frozen: no gradient, and constant batch statistics. InputError for a beginning
    that fits no part.
    """
    parts = dict(network.named_children())
    unknown = [start for start in only if not any(name.startswith(start) for name in parts)]
    if unknown:
        raise InputError(
            f"optimizer.only: no part of '{network.config.name}' begins with {unknown[0]!r}; "
            f"it has {', '.join(parts)}."
        )
    network.train()
    for name, part in parts.items():
        trained = not only or name.startswith(only)
        part.requires_grad_(trained)
        if not trained:
            part.eval()


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
                f"loop.logit_offsets: {name!r:.80} is named twice or no class of the network; it "
                f"has {', '.join(names) or 'none'}."
            )
        values[names.index(name)] = offset
    return values


def adjust_logits(
    state_dict: Mapping[str, Tensor],
    weights: Tensor | None,
    share: float,
    offsets: Tensor | None = None,
) -> dict[str, Tensor]:
    """Return weights whose semantic bias is lowered by share * log(class weight).

    ``offsets`` (num_classes,) are added to it. A network trained with class weights w predicts the
    odds of w * p; subtracting log w from the logits gives p (Menon et al. 2021).
    """
    adjusted = dict(state_dict)
    if weights is not None and share:
        bias = adjusted["semantic_head.bias"]
        logs = torch.where(weights > 0, weights, 1.0).log()  # a class without weight is not changed
        adjusted["semantic_head.bias"] = bias - share * logs.to(bias)
    if offsets is not None:
        bias = adjusted["semantic_head.bias"]
        adjusted["semantic_head.bias"] = bias + offsets.to(bias)
    return adjusted


def mix_weights(
    first: Mapping[str, Tensor], second: Mapping[str, Tensor], share: float
) -> dict[str, Tensor]:
    """Return (1 - share) * first + share * second of each tensor; counts are those of second."""
    return {
        name: torch.lerp(first[name].to(value), value, share)
        if value.is_floating_point()
        else value
        for name, value in second.items()
    }
