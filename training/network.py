"""The network of a recipe: built, and started from other weights."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models import Network, NetworkConfig, create_model, load_checkpoint
from models.registry import NETWORKS
from runtime.errors import InputError
from training.datasets.class_mapping import list_classes
from training.initial_weights import start_from
from training.recipe import ModelRecipe


def build_network(recipe: ModelRecipe, init: Path | None) -> Network:
    """Return the network of `build_with_weights`."""
    return build_with_weights(recipe, init)[0]


def build_with_weights(recipe: ModelRecipe, init: Path | None) -> tuple[Network, frozenset[str]]:
    """Build a recipe's network, with the weights of the checkpoint ``init`` as far as they fit.

    Images are normalised as ``init``'s network does, unless the recipe says otherwise: the weights
    know no other values.

    Returns:
        The network, and the names of the tensors that ``init`` gave.

    Raises:
        InputError: if the network cannot be built.
        CheckpointError: if ``init`` cannot be read or nothing of it fits.
    """
    changes: dict[str, Any] = {}
    source = None if init is None else load_checkpoint(init).model
    if source is not None:
        changes |= {"rgb_mean": source.config.rgb_mean, "rgb_std": source.config.rgb_std}
    try:
        if recipe.name in NETWORKS:
            config = _configuration(NETWORKS[recipe.name].config, recipe.config)
            changes |= {key: getattr(config, key) for key in recipe.config}
            changes["classes"] = list_classes(recipe.class_table) if config.classes else ()
        network = create_model(recipe.name, **changes)
    except ValueError as error:
        raise InputError(f"the recipe's model cannot be built: {error}.") from error
    if init is None or source is None:
        return network, frozenset()
    return network, start_from(network, source, init)


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
