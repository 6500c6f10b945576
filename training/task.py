"""What a recipe trains on what: all that can be refused before a run writes anything."""

import contextlib
import copy
import math
import random
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from models import Network
from models.answers import check_output
from runtime.contract import MIN_SIDE
from runtime.cores import available_cores
from runtime.errors import InputError
from training.datasets.sample import SampleSource
from training.distributed import Processes, synchronise_batch_norm
from training.evaluation.scoring import figure_names
from training.initial_weights import Weights
from training.lidar.split import LidarInput
from training.limits import PAIR_STEP_PX
from training.loading.augment import with_crop
from training.loading.mixture import DepthTarget
from training.loading.open_dataset import (
    FREQUENCY_SAMPLES,
    frame_files,
    open_dataset,
    spread_indices,
    spread_pictures,
)
from training.losses import SSDNetLoss, class_weights
from training.network import build_network, require_encoder, train_parts
from training.recipe import DataRecipe, Recipe
from training.survey import learned, survey
from training.teacher import prepare_teacher

#: Frames of a validation set that are scored ahead of the training, to know its scores.
_SCORED = 20


@dataclass(frozen=True)
class Task:
    """An opened recipe.

    Attributes:
        data: the recipe's, with a crop for its sets and no more workers than cores.
        sources: the sets of the mixture.
        validation: the validation sets by title.
        network: on the device of the process; only the parts that are trained have gradients.
        criterion: the loss, there too.
        depth_target: unit of the depth target, and the depth of the sky.
        teacher: the network whose answers are learned, on the device too; None = there is none.
        class_weights: of the semantic loss; None = it has none.
    """

    data: DataRecipe
    sources: Sequence[SampleSource]
    validation: Mapping[str, SampleSource]
    network: Network
    criterion: SSDNetLoss
    depth_target: DepthTarget
    class_weights: Tensor | None
    teacher: Network | None = None

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that the loss uses."""
        return self.criterion.config.targets_for(self.network.heads)

    @property
    def pair_step(self) -> int:
        """Step [px] of the shift between two views: cells of the semantic head then coincide."""
        return math.lcm(PAIR_STEP_PX, self.network.semantic_stride)


def open_task(
    recipe: Recipe,
    processes: Processes,
    data: Sequence[Path],
    init: Weights | None,
    teacher: Weights | None = None,
    *,
    resumed: bool = False,
) -> Task:
    """Seed the random numbers, open the data sets and build network and loss, see `loop.train`.

    A ``resumed`` training does not read pretrained weights again.
    """
    # OpenCV's thread pool does not survive the fork of the loader's workers: they would hang.
    cv2.setNumThreads(0)
    torch.manual_seed(recipe.data.seed)
    random.seed(recipe.data.seed)
    np.random.seed(recipe.data.seed)  # noqa: NPY002  (for libraries that draw from it)

    classes = recipe.model.class_table
    sources = [open_dataset(item, data, classes=classes) for item in recipe.data.source]
    found = survey(recipe, sources, recipe.model.network_config())
    decided = replace(
        recipe.data,
        augment=with_crop(recipe.data.augment, found.smallest),
        workers=min(recipe.data.workers, available_cores()),
    )
    validation = {
        item.title: open_dataset(item, data, classes=classes) for item in recipe.validation.source
    }
    network = build_network(recipe.model, init, resumed=resumed, pictures=spread_pictures(sources))
    train_parts(network, recipe.optimizer.only, recipe.optimizer.frozen)
    if recipe.optimizer.encoder_rate is not None:
        require_encoder(network)
    try:
        check_output(network)
    except ValueError as error:
        raise InputError(f"the network {network.config.name!r}: {error}") from error
    _require_batches(network, decided, processes)
    _require_learning(recipe, network, sources)
    targets = recipe.loss.targets_for(network.heads)
    warnings = [text for target, text in found.notes if target in targets]
    trained = frame_files(sources)
    for title, source in validation.items():
        if not _require_figures(recipe, network, title, source):
            warnings.append(f"{title} has no ground truth for a head: it gives no scores")
        if both := len(frame_files([source]) & trained):
            warnings.append(
                f"{both} of the {len(source)} frames of {title} are also trained on: its scores do "
                "not hold for other frames"
            )
    for text in warnings if processes.is_first else ():
        tqdm.write(f"warning: {text}", file=sys.stderr)
    taught_by = prepare_teacher(teacher, recipe.loss, network)
    weights = None
    if "semantic" in network.heads and recipe.loss.weighs_classes and found.classes.any():
        weights = class_weights(torch.from_numpy(found.classes), recipe.loss.class_weighting)
    network = network.to(processes.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    synchronise_batch_norm(network, processes)
    criterion = SSDNetLoss(
        recipe.loss,
        weights,
        max_depth_m=network.config.max_depth_m,
        target_depth_m=network.config.target_depth_m,
        road=recipe.model.class_id("road"),
    ).to(processes.device)
    sky = recipe.model.class_id("sky") if recipe.data.sky_depth_m else None
    depth = DepthTarget(
        network.config.canonical_focal_px,
        sky,
        recipe.data.sky_depth_m,
        max_depth_m=network.config.max_depth_m,
    )
    if taught_by is not None:
        taught_by = taught_by.to(processes.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    task = Task(decided, sources, validation, network, criterion, depth, weights, taught_by)
    if 0 < recipe.data.augment.pair_shift < task.pair_step:
        raise InputError(
            f"data.augment.pair_shift = {recipe.data.augment.pair_shift}; the classes of "
            f"{network.config.name!r} are on cells of {task.pair_step} px, so that the second view "
            f"would never be shifted. Set at least {task.pair_step}, or 0 for one view."
        )
    return task


def _require_batches(network: Network, data: DataRecipe, processes: Processes) -> None:
    """Raise InputError for batches and crops of which normalisation sees a single value."""
    views = 2 if data.augment.pair_shift else 1
    count, (height, width) = views * data.batch_size * processes.count, data.augment.size
    batch = [torch.empty(count, channels, height, width, device="meta") for channels in (3, 1)]
    try:
        # A network that reads values, which these tensors lack, is not checked.
        with torch.no_grad(), contextlib.suppress(RuntimeError):
            copy.deepcopy(network).to("meta")(*batch)
    except ValueError as error:
        raise InputError(
            f"{network.config.name!r} cannot be trained on batches of {count} crops of "
            f"{height}x{width} ({error}). Raise data.batch_size or data.augment.crop."
        ) from error


def _require_learning(recipe: Recipe, network: Network, sources: Sequence[SampleSource]) -> None:
    """Raise InputError if no term of the loss trains a part, or none applies to any frame."""
    name, loss = network.config.name, recipe.loss
    terms = loss.terms_for(network.heads)
    if not terms:
        raise InputError(
            f"no loss term with a weight above 0 applies to the heads of {name!r} "
            f"({', '.join(network.heads)}). Set the weight of a term for these heads."
        )
    rates = recipe.optimizer
    for part, layers in network.named_children():
        own = rates.encoder_rate if part == "encoder" else None
        if not (rates.learning_rate if own is None else own):
            layers.requires_grad_(False)  # until `TrainingState` chooses the trained parts
    learning = _learning_heads(network)
    terms = [term for term in terms if learning & loss.heads_of(term)]
    if not terms:
        raise InputError(
            f"nothing would learn: no term of the loss depends on a part of {name!r} that is "
            "trained at a rate above 0. Change optimizer.only, optimizer.frozen or the rates, or "
            "set the weight of another term."
        )
    targets = [loss.target_of(term) for term in terms]
    if "" in targets:
        return
    frames = (source[i] for source in sources for i in spread_indices(source, FREQUENCY_SAMPLES))
    if not any(
        learned(frame, target, network.config).any() for frame in frames for target in set(targets)
    ):
        raise InputError(
            f"no frame of {', '.join(item.title for item in recipe.data.source)} has a target of "
            f"the loss: its terms {', '.join(terms)} need {' or '.join(sorted(set(targets)))} "
            f"(depth up to {network.config.target_depth_m:g} m). Add a set that has it, or set the "
            "weight of another term."
        )


def _learning_heads(network: Network) -> set[str]:
    """Return the heads whose answers depend on a parameter that is trained."""
    size = (1, 1, MIN_SIDE, MIN_SIDE)
    # Batch statistics must not change; `TrainingState` chooses what is in training mode.
    output = network.eval()(torch.zeros(size).expand(-1, 3, -1, -1), torch.zeros(size))
    answers: dict[str, Sequence[Tensor | None]] = {
        "semantic": [output.semantic_logits],
        "depth": output.depths or (),
        "boundary": [output.boundary_logits],
        "depth_uncertainty": [output.depth_uncertainty],
        **{head: [answer] for head, answer in output.others.items()},
    }
    return {
        head
        for head, found in answers.items()
        if any(answer is not None and answer.requires_grad for answer in found)
    }


def _require_figures(recipe: Recipe, network: Network, title: str, source: SampleSource) -> bool:
    """Return whether a set gives scores.

    Raises InputError if it lacks the LiDAR or the score of ``validation.best``.
    """
    name, _, best = recipe.validation.best.rpartition("/")
    lidar = LidarInput.parse(recipe.validation.lidar)
    for count in (_SCORED, FREQUENCY_SAMPLES):  # mostly few frames are enough
        known = figure_names(network, source, spread_indices(source, count), lidar)
        if known and (name != title or best in known):
            return True
    if name == title:
        raise InputError(
            f"validation.best = {recipe.validation.best!r}; {title} gives {', '.join(known)}. "
            "Choose one of these."
        )
    return False
