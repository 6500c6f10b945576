"""The parts of a network that are trained, and their learning rates."""

import math
from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass

from models import Network
from runtime.base.errors import InputError
from training.base.limits import STRICT, NotNegative, Share, Steps
from training.losses import SSDNetLoss


@dataclass(frozen=True, config=STRICT)
class OptimizerRecipe:
    """AdamW, or the paper's SGD (momentum 0 is the paper's).

    Attributes:
        encoder_rate: rate of the encoder; one schedule scales both. None: `learning_rate`.
        only: parts of the network that are trained, by the beginning of their names ("depth_"); the
            others are frozen with their batch statistics. Empty: all.
        frozen: layers that are not trained, by the beginning of their names ("encoder.stem"); their
            batch statistics are constant, too.
        fixed_statistics: whether all layers keep their batch statistics: for short trainings of
            good weights on pictures that are not alike, as good ones and spoilt ones.
    """

    name: Literal["adamw", "sgd"] = "adamw"
    learning_rate: NotNegative = 2e-3
    encoder_rate: NotNegative | None = None
    weight_decay: NotNegative = 1e-2
    momentum: Share = 0.9
    only: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    frozen: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    fixed_statistics: bool = False


@dataclass(frozen=True, config=STRICT)
class ScheduleRecipe:
    """Linear warm-up, then a cosine to 0 or a constant rate."""

    steps: Steps
    warmup_steps: Annotated[int, Field(ge=0, le=10**8)] = 0
    shape: Literal["cosine", "constant"] = "cosine"

    def __post_init__(self) -> None:
        """Check that the warm-up ends."""
        if self.warmup_steps > self.steps:
            raise ValueError(
                f"warmup_steps = {self.warmup_steps}: longer than the run of steps = {self.steps}"
            )


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
    if recipe.fixed_statistics:
        for layer in network.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.eval()
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


def learning_rate(schedule: ScheduleRecipe, peak: float, step: int) -> float:
    """Return the rate of a step: linear warm-up from peak / warmup_steps, then the schedule."""
    if step < schedule.warmup_steps:
        return peak * (step + 1) / schedule.warmup_steps
    if schedule.shape == "constant":
        return peak
    progress = (step - schedule.warmup_steps) / max(1, schedule.steps - schedule.warmup_steps)
    share = 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
    return peak * share
