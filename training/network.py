"""The network of a recipe, with random or known weights."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from models import Network, create_model, load_checkpoint
from models.registry import NETWORKS
from runtime.errors import CheckpointError, InputError
from training.datasets.class_mapping import list_classes
from training.recipe import ModelRecipe

#: Layers whose weights are of one class each.
_CLASS_LAYERS = ("semantic_head.",)
#: Settings that change what weights of the same shape mean.
_MEANINGS = {
    "max_depth_m": "the depth range [m]",
    "sparse_depth_gain": "the factor on the sparse depth",
    "boundary_gating": "the gating by boundaries",
}


def build_network(recipe: ModelRecipe, init: Path | None) -> Network:
    """Build a recipe's network; ``init`` is a checkpoint whose weights it starts from.

    Raises InputError for what cannot be built, CheckpointError for what cannot be taken over.
    """
    known = NETWORKS.get(recipe.name)
    with_classes = known is not None and "semantic" in known.config.heads
    # Only what the recipe changes: not every network has these.
    changes: dict[str, Any] = {}
    if not recipe.boundary_gating:
        changes["boundary_gating"] = False
    if recipe.sparse_depth_gain != 1:
        changes["sparse_depth_gain"] = recipe.sparse_depth_gain
    try:
        network = create_model(
            recipe.name,
            classes=list_classes(recipe.class_table) if with_classes else None,
            max_depth_m=recipe.max_depth_m,
            **changes,
        )
    except ValueError as error:
        raise InputError(f"the recipe's model cannot be built: {error}.") from error
    if init is not None:
        _start_from(network, init)
    return network


def _start_from(network: Network, init: Path) -> None:
    """Take over the weights of a checkpoint; layers that it lacks, or has in another shape, stay.

    So a network with other classes or another head starts from what is already known. Layers
    that tell classes apart stay as well where the classes are others, even as many. What starts
    anew, and what is taken over but means something else, is said on standard error. Raises
    CheckpointError if nothing fits.
    """
    source = load_checkpoint(init).model
    known = source.state_dict() if type(source) is type(network) else {}
    wanted = network.state_dict()
    names, known_names = (
        [info.name for info in model.config.classes or ()] for model in (network, source)
    )
    taken = {
        name: known[name]
        for name, value in wanted.items()
        if name in known
        and known[name].shape == value.shape
        and (names == known_names or not name.startswith(_CLASS_LAYERS))
    }
    fresh = sorted({name.rsplit(".", 1)[0] for name in wanted.keys() - taken.keys()})
    if not any(p.ndim > 1 and name in taken for name, p in network.named_parameters()):
        raise CheckpointError(
            f"{init}: none of its layers fits the recipe's '{network.config.name}'. "
            "Start from a checkpoint of the same family."
        )
    network.load_state_dict({**wanted, **taken})
    if fresh:
        tqdm.write(f"{init}: {len(taken)} of {len(wanted)} tensors taken over", file=sys.stderr)
        tqdm.write(f"starting anew: {', '.join(fresh)}", file=sys.stderr)
    for key, meaning in _MEANINGS.items():
        before, now = getattr(source.config, key, None), getattr(network.config, key, None)
        if before != now:
            tqdm.write(
                f"{init}: {meaning} was {before}, here it is {now}; its weights have to adapt",
                file=sys.stderr,
            )


def adjust_logits(
    state_dict: Mapping[str, Tensor], weights: Tensor | None, share: float
) -> dict[str, Tensor]:
    """Return the weights of a network whose semantic bias is lowered by share * log(class weight).

    A network trained with class weights w answers with the odds of w * p; taking the log of them
    off the logits gives p back (Menon et al. 2021), a share of it lies between. Nothing changes
    without class weights.
    """
    adjusted = dict(state_dict)
    if weights is not None and share:
        bias = adjusted["semantic_head.bias"]
        logs = torch.where(weights > 0, weights, 1.0).log()  # a class without weight stays
        adjusted["semantic_head.bias"] = bias - share * logs.to(bias)
    return adjusted
