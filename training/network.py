"""The network of a recipe, with random or known weights."""

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
    """Build a recipe's network; ``init`` is a checkpoint whose weights it starts from.

    Raises InputError for what cannot be built, CheckpointError for what cannot be taken over.
    """
    # Only what the recipe changes: not every network has these.
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
    """Change fields of a configuration by plain values; a network without semantics has no classes.

    Raises ValueError for unknown fields, values of the wrong type and what cannot be built.
    """
    values = {**config.to_dict(), **changes}
    if changes.get("semantic_head") is False:
        values["classes"] = ()
    return type(config).from_dict(values)


def train_parts(network: Network, only: tuple[str, ...]) -> None:
    """Put the parts whose names begin with one of ``only`` into training mode; () = all.

    The others are frozen: no gradient, and the batch statistics that they have. Raises InputError
    for a beginning that fits no part.
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
    """What is added to the logit of each class, (num_classes,); None where that is nothing.

    Raises InputError for a class that the network does not tell, or that is named twice.
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
    """Return the weights of a network whose semantic bias is lowered by share * log(class weight).

    ``offsets`` (num_classes,) are added to it. A network trained with class weights w answers with
    the odds of w * p; taking the log of them off the logits gives p back (Menon et al. 2021), a
    share of it lies between. Nothing changes without class weights and offsets.
    """
    adjusted = dict(state_dict)
    if weights is not None and share:
        bias = adjusted["semantic_head.bias"]
        logs = torch.where(weights > 0, weights, 1.0).log()  # a class without weight stays
        adjusted["semantic_head.bias"] = bias - share * logs.to(bias)
    if offsets is not None:
        bias = adjusted["semantic_head.bias"]
        adjusted["semantic_head.bias"] = bias + offsets.to(bias)
    return adjusted
