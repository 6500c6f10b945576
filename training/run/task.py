"""An opened recipe: networks and data, checked before a run writes anything."""

import contextlib
import copy
import math
import random
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import torch
from tqdm import tqdm

from models import Network
from models.answers import check_output, head_maps
from runtime.base.errors import InputError
from runtime.contract.contract import MIN_SIDE
from runtime.engine.cores import available_cores
from training.base.own_code import named_errors
from training.base.processes import Processes
from training.base.stop_signal import Stop
from training.datasets.sample import SampleSource
from training.lidar.split import LidarInput
from training.loading.augment_config import PAIR_STEP_PX, with_crop
from training.loading.data_recipe import DataRecipe
from training.loading.depth_values import DepthTarget
from training.loading.open_dataset import (
    FREQUENCY_SAMPLES,
    Survey,
    Watched,
    count_shared,
    open_dataset,
    spread_pictures,
    survey,
)
from training.losses import SSDNetLoss, class_weights
from training.losses.terms import Term
from training.run.network import build_network
from training.run.optimizer import OptimizerRecipe, build_optimizer
from training.run.provenance import require_own_data
from training.run.recipe import Recipe
from training.run.training_run import TrainingRun
from training.run.validation_recipe import ValidationRecipe
from training.scores.scoring import figure_names
from training.weights.initial_weights import prepare_teacher

# Frames of a validation set that are scored ahead of the training, to know its scores.
_SCORED = 20


@dataclass(frozen=True)
class Task:
    """An opened recipe.

    Attributes:
        recipe: the recipe as it was given.
        run: what controls the training beside the recipe.
        processes: the processes that train together.
        data: the data of the recipe, with a crop for its sets and no more workers than cores.
        sources: the sets of the mixture.
        validation: the validation sets by title.
        network: on the device of the process; only the parts that are trained have gradients.
        criterion: the loss, on the same device.
        optimizer: the optimiser of network and loss, at the recipe's rates.
        targets: the targets that the loss uses.
        teacher: the network whose answers are learned, on the same device; None: no teacher.
    """

    recipe: Recipe
    run: TrainingRun
    processes: Processes
    data: DataRecipe
    sources: Sequence[SampleSource]
    validation: Mapping[str, SampleSource]
    network: Network
    criterion: SSDNetLoss
    optimizer: torch.optim.Optimizer
    targets: Collection[str]
    teacher: Network | None

    @property
    def pair_step(self) -> int:
        """Step [px] of the shift between two views: cells of the semantic head then coincide."""
        return math.lcm(PAIR_STEP_PX, self.network.semantic_stride)

    @property
    def crops(self) -> int:
        """Crops in a batch of this process: one or two views of each frame."""
        return (2 if self.data.augment.pair_shift else 1) * self.data.batch_size

    @property
    def depth_target(self) -> DepthTarget:
        """Unit of the depth target, and the depth of the sky."""
        config, sky_depth_m = self.network.config, self.recipe.data.sky_depth_m
        sky = self.recipe.model.class_id("sky") if sky_depth_m else None
        return DepthTarget(config.canonical_focal_px, sky, sky_depth_m, config.max_depth_m)

    @property
    def stop(self) -> Stop:
        """When this process may leave by itself, see `Processes.own_stop`."""
        return self.processes.own_stop(self.run.stop)


def open_task(
    recipe: Recipe, run: TrainingRun, processes: Processes, *, resumed: bool = False
) -> Task:
    """Seed the random numbers, open the data sets and build network and loss, see `loop.train`.

    A `resumed` training does not read pretrained weights again. Raises StopRequested once `run`
    is stopped, unless other processes would wait for this one.
    """
    stop = processes.own_stop(run.stop)
    _seed(recipe.data.seed)
    opened = partial(open_dataset, roots=run.data, classes=recipe.model.class_table, stop=stop)
    sources = [opened(item) for item in recipe.data.source]
    validation = {item.title: opened(item) for item in recipe.validation.source}
    network, teacher = _open_networks(recipe, sources, run, processes, resumed=resumed)
    require_own_data(recipe, init=run.init, teacher=run.teacher)
    watched = [Watched(source, stop) for source in sources]
    found = survey(recipe.data.source, watched, recipe.model.class_names, network.config)
    terms = recipe.loss.terms_for(network.heads)
    criterion = _build_loss(recipe, network, terms, found).to(processes.device)
    task = Task(
        recipe=recipe,
        run=run,
        processes=processes,
        data=replace(
            recipe.data,
            augment=with_crop(recipe.data.augment, found.smallest),
            workers=min(recipe.data.workers, available_cores()),
        ),
        sources=sources,
        validation=validation,
        network=network,
        criterion=criterion,
        optimizer=build_optimizer(recipe.optimizer, network, criterion),
        targets=sorted({term.target for term in terms.values()} - {""}),
        teacher=teacher,
    )
    # The warnings explain why nothing would learn.
    _report((text for target, text in found.notes if target in task.targets), processes)
    _require_batches(task)
    _require_learning(task, terms, found.targets)
    _report(_doubts_of_validation(task), processes)
    _require_shift(task)
    return task


def _report(warnings: Iterable[str], processes: Processes) -> None:
    for text in warnings if processes.is_first else ():
        tqdm.write(f"warning: {text}", file=sys.stderr)


def _seed(seed: int) -> None:
    """Seed the random numbers of this process, and prepare it for the fork of workers."""
    # OpenCV's thread pool does not survive the fork of the loader's workers: they would hang.
    cv2.setNumThreads(0)
    torch.manual_seed(seed)
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  (for libraries that draw from it)


def _open_networks(
    recipe: Recipe,
    sources: Sequence[SampleSource],
    run: TrainingRun,
    processes: Processes,
    *,
    resumed: bool,
) -> tuple[Network, Network | None]:
    """Build the network and its teacher on the device; InputError for a network's wrong output."""
    pictures = spread_pictures(sources)
    with named_errors(f"the network {recipe.model.name!r}"):
        network = build_network(recipe.model, run.init, resumed=resumed, pictures=pictures)
    taught_by = prepare_teacher(run.teacher, recipe.loss, network)
    try:
        with named_errors(f"the network {network.config.name!r}", but=ValueError):
            check_output(network)
    except ValueError as error:
        raise InputError(f"the network {network.config.name!r}: {error}") from error
    for part in (network, taught_by):
        if part is not None:
            part.to(processes.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network, taught_by


def _build_loss(
    recipe: Recipe, network: Network, terms: Collection[str], found: Survey
) -> SSDNetLoss:
    """Build the loss; its class weights are those of the surveyed frames."""
    weights = None
    if "semantic" in terms:
        weights = class_weights(torch.from_numpy(found.classes), recipe.loss.class_weighting)
    return SSDNetLoss(
        recipe.loss,
        weights,
        max_depth_m=network.config.max_depth_m,
        unmeasured_range_m=network.config.unmeasured_range_m,
        road=recipe.model.class_id("road"),
    )


def _doubts_of_validation(task: Task) -> Iterator[str]:
    """Yield why scores of validation sets do not hold, or why there are none."""
    for title, source in task.validation.items():
        if count := count_shared([source], task.sources):
            yield (
                f"{count} of the {len(source)} frames of {title} are also trained on: its "
                "scores do not hold for other frames"
            )
    for title, source in task.validation.items():
        if not _gives_scores(
            task.recipe.validation, task.network, title, Watched(source, task.stop)
        ):
            yield f"{title} has no ground truth for a head: it gives no scores"


def _require_shift(task: Task) -> None:
    """Raise InputError where the second view could never be shifted by a cell."""
    shift = task.data.augment.pair_shift
    if 0 < shift < task.pair_step:
        raise InputError(
            f"data.augment.pair_shift = {shift}; the classes of {task.network.config.name!r} are "
            f"on cells of {task.pair_step} px, so that the second view would never be shifted: "
            f"set at least {task.pair_step}, or 0 for one view"
        )


def _require_batches(task: Task) -> None:
    """Raise InputError if batch normalisation would see a single value of each channel."""
    count, (height, width) = task.crops * task.processes.count, task.data.augment.size
    if count > 1:  # then it sees a value of each crop
        return
    batch = [torch.empty(count, channels, height, width, device="meta") for channels in (3, 1)]
    try:
        # A network that reads values, which these tensors lack, is not checked.
        with torch.no_grad(), contextlib.suppress(RuntimeError):
            copy.deepcopy(task.network).to("meta")(*batch)
    except ValueError as error:
        raise InputError(
            f"{task.network.config.name!r} cannot be trained on batches of {count} crops of "
            f"{height}x{width} ({error}): raise data.batch_size or data.augment.crop"
        ) from error


def _require_learning(task: Task, terms: Mapping[str, Term], labelled: Collection[str]) -> None:
    """Raise InputError if no term of the loss trains a part, or none has labels in any frame."""
    recipe, network, name = task.recipe, task.network, task.network.config.name
    if not terms:
        raise InputError(
            f"no loss term with a weight above 0 applies to the heads of {name!r} "
            f"({', '.join(network.heads)}): set the weight of a term for these heads"
        )
    learning = _learning_heads(network, recipe.optimizer)
    targets = {key: term.target for key, term in terms.items() if learning & term.heads}
    if not targets:
        raise InputError(
            f"nothing would learn: no term of the loss depends on a part of {name!r} that is "
            "trained at a rate above 0: change optimizer.only, optimizer.frozen or the rates, or "
            "set the weight of another term"
        )
    if {"", *labelled}.isdisjoint(targets.values()):
        raise InputError(
            f"no frame of {', '.join(item.title for item in recipe.data.source)} has a target of "
            f"the loss: its terms {', '.join(targets)} need "
            f"{' or '.join(sorted(set(targets.values())))} "
            f"(depth up to {network.config.unmeasured_range_m:g} m): add a set that has it, or set "
            "the weight of another term"
        )


def _learning_heads(network: Network, rates: OptimizerRecipe) -> set[str]:
    """Return the heads whose answers depend on a parameter that is trained."""
    network = copy.deepcopy(network).eval()
    for part, layers in network.named_children():
        own = rates.encoder_rate if part == "encoder" else None
        if not (rates.learning_rate if own is None else own):
            layers.requires_grad_(False)
    depth = torch.zeros(1, 1, MIN_SIDE, MIN_SIDE, device=network.rgb_mean.device)
    output = network(depth.expand(-1, 3, -1, -1), depth)
    return {head for head, answer in head_maps(output).items() if answer.requires_grad}


def _gives_scores(
    recipe: ValidationRecipe, network: Network, title: str, source: SampleSource
) -> bool:
    """Return whether a set gives scores.

    Raises InputError if it lacks the LiDAR, or the score of `validation.best`.
    """
    name, _, figure = recipe.best.rpartition("/")
    lidar = LidarInput.parse(recipe.lidar)
    for count in (_SCORED, FREQUENCY_SAMPLES):  # mostly few frames are enough
        spread = range(0, len(source), math.ceil(len(source) / count))
        known = figure_names(network, source, spread, lidar)
        if known and (name != title or figure in known):
            return True
    if name == title:
        raise InputError(
            f"validation.best = {recipe.best!r}; {title} gives {', '.join(known)}: choose one of "
            "these"
        )
    return False
