"""What a recipe trains on what: all that can be refused before a run writes anything."""

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
from runtime.contract import MIN_SIDE
from runtime.cores import available_cores
from runtime.errors import InputError
from training.datasets.sample import SampleSource, target_kind
from training.distributed import Processes, synchronise_batch_norm
from training.evaluation.scoring import figure_names, require_lidar
from training.initial_weights import Weights
from training.lidar.split import LidarInput
from training.limits import PAIR_STEP_PX
from training.loading.augment import with_crop
from training.loading.mixture import DepthTarget
from training.loading.open_dataset import (
    FREQUENCY_SAMPLES,
    open_dataset,
    spread_indices,
    spread_pictures,
)
from training.losses import SSDNetLoss, class_weights
from training.network import build_network, require_encoder, train_parts
from training.recipe import DataRecipe, Recipe
from training.teacher import prepare_teacher


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
    decided = replace(
        recipe.data,
        augment=with_crop(recipe.data.augment, sources),
        workers=min(recipe.data.workers, available_cores()),
    )
    validation = {
        item.title: open_dataset(item, data, classes=classes) for item in recipe.validation.source
    }
    require_lidar(validation, LidarInput.parse(recipe.validation.lidar))
    network = build_network(recipe.model, init, resumed=resumed, pictures=spread_pictures(sources))
    train_parts(network, recipe.optimizer.only, recipe.optimizer.frozen)
    if recipe.optimizer.encoder_rate is not None:
        require_encoder(network)
    heads = network.heads
    _require_learning(recipe, network, sources)
    if recipe.validation.best:
        _require_figure(recipe, network, validation)
    taught_by = prepare_teacher(teacher, recipe.loss, network)
    weights = None
    if "semantic" in heads and recipe.loss.weighs_classes:
        weights = _weigh_classes(recipe, sources, network.config.num_classes)
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


def _require_learning(recipe: Recipe, network: Network, sources: Sequence[SampleSource]) -> None:
    """Raise InputError if no term of the loss trains a part, or none applies to any frame."""
    name, loss = network.config.name, recipe.loss
    terms = loss.terms_for(network.heads)
    if not terms:
        raise InputError(
            f"no loss term with a weight above 0 applies to the heads of {name!r} "
            f"({', '.join(network.heads)}). Set the weight of a term for these heads."
        )
    learning = _learning_heads(network)
    terms = [term for term in terms if learning & loss.heads_of(term)]
    if not terms:
        raise InputError(
            f"nothing would learn: no term of the loss depends on a part of {name!r} that is "
            "trained. Change optimizer.only or optimizer.frozen, or set the weight of another term."
        )
    targets = [loss.target_of(term) for term in terms]
    if "" in targets:
        return
    frames = (source[i] for source in sources for i in spread_indices(source, FREQUENCY_SAMPLES))
    if not any(
        (frame.target(target) != target_kind(target).unlabelled).any()
        for frame in frames
        for target in set(targets)
    ):
        raise InputError(
            f"no frame of {_titles(recipe)} has a target of the loss: its terms "
            f"{', '.join(terms)} need {' or '.join(sorted(set(targets)))}. Add a set that has it, "
            "or set the weight of another term."
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


def _require_figure(
    recipe: Recipe, network: Network, validation: Mapping[str, SampleSource]
) -> None:
    """Raise InputError if the set of ``validation.best`` does not have the score."""
    title, _, figure = recipe.validation.best.rpartition("/")
    lidar = LidarInput.parse(recipe.validation.lidar)
    for count in (1, FREQUENCY_SAMPLES):  # mostly the first frame is enough
        indices = spread_indices(validation[title], count)
        known = figure_names(network, validation[title], indices, lidar)
        if figure in known:
            return
    raise InputError(
        f"validation.best = {recipe.validation.best!r}; {title} gives {', '.join(known)}. Choose "
        "one of these."
    )


def _weigh_classes(
    recipe: Recipe, sources: Sequence[SampleSource], num_classes: int
) -> Tensor | None:
    """Return the weights of the classes; None without labels, whose terms then never apply.

    Pixels are counted in about `FREQUENCY_SAMPLES` frames without augmentation, by the weights of
    the sets; labels made by a network count by their weight.
    """
    counts = np.zeros(num_classes, dtype=np.float64)
    total = sum(item.weight for item in recipe.data.source)
    for item, source in zip(recipe.data.source, sources, strict=True):
        wanted = max(1, round(FREQUENCY_SAMPLES * item.weight / total))
        frames = spread_indices(source, wanted)
        for index in frames:
            sample = source[index]
            seen = np.bincount(sample.semantic.ravel(), minlength=256)[:num_classes]
            weight = sample.weights.get("semantic", 1.0) * wanted / len(frames)
            counts += seen * weight / sample.semantic.size
    counts = np.round(counts * 1_000_000)
    if not counts.any():
        tqdm.write(
            f"no pixel of {_titles(recipe)} is labelled: classes and boundaries are not trained",
            file=sys.stderr,
        )
        return None
    return class_weights(torch.from_numpy(counts), recipe.loss.class_weighting)


def _titles(recipe: Recipe) -> str:
    return ", ".join(item.title for item in recipe.data.source)
