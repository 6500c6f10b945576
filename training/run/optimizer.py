"""The parts of a network that are trained, and their learning rates."""

from typing import Any

import torch

from models import Network
from runtime.base.errors import InputError
from training.losses import SSDNetLoss
from training.run.recipe import OptimizerRecipe


def build_optimizer(
    recipe: OptimizerRecipe, network: Network, criterion: SSDNetLoss
) -> torch.optim.Optimizer:
    """Choose the parts of a network that are trained; return AdamW or SGD over it and the loss.

    Biases, normalisation and the parameters of the loss do not decay. The encoder may have a rate
    of its own.

    Raises:
        InputError: as `train_parts`, and for a rate of an encoder that the network lacks.
    """
    train_parts(network, recipe.only, recipe.frozen)
    encoder = dict(network.named_children()).get("encoder")
    separate = recipe.encoder_rate is not None
    if separate and encoder is None:
        raise InputError(
            f"optimizer.encoder_rate: '{network.config.name}' has no part called 'encoder': leave "
            "it out, or take ssdnet-lite or ssdnet-nano"
        )
    apart = set(encoder.parameters()) if separate and encoder else set()
    groups: list[dict[str, Any]] = []
    for of_encoder, rate in ((False, recipe.learning_rate), (True, recipe.encoder_rate)):
        chosen = [p for p in network.parameters() if (p in apart) == of_encoder]
        others = [] if of_encoder else list(criterion.parameters())
        kernels, vectors = ([p for p in chosen if (p.ndim > 1) == many] for many in (True, False))
        if chosen:
            groups.append({"params": kernels, "lr": rate, "weight_decay": recipe.weight_decay})
            groups.append({"params": [*vectors, *others], "lr": rate, "weight_decay": 0.0})
    if recipe.name == "sgd":
        return torch.optim.SGD(groups, momentum=recipe.momentum)
    return torch.optim.AdamW(groups)


def train_parts(network: Network, only: tuple[str, ...], frozen: tuple[str, ...] = ()) -> None:
    """Put the parts whose names begin with an entry of `only` into training mode; () = all.

    The others, and layers at any depth whose names begin with an entry of `frozen`, have no
    gradient and constant batch statistics. InputError for an entry that fits no name.
    """
    parts = dict(network.named_children())
    unknown = [start for start in only if not any(name.startswith(start) for name in parts)]
    if unknown:
        raise InputError(
            f"optimizer.only: no part of '{network.config.name}' begins with {unknown[0]!r}: "
            f"name some of {', '.join(parts)}"
        )
    network.train()
    for name, part in parts.items():
        trained = not only or name.startswith(only)
        part.requires_grad_(trained)
        if not trained:
            part.eval()
    for start in frozen:
        layers = [part for name, part in network.named_modules() if name.startswith(start)]
        if not layers:
            raise InputError(
                f"optimizer.frozen: no layer of '{network.config.name}' begins with {start!r}: "
                f"name layers of its parts, {', '.join(parts)}"
            )
        for layer in layers:
            layer.requires_grad_(False).eval()
