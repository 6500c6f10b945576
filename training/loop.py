"""The training loop: one flat function from a recipe to checkpoints."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from models import Network, NetworkOutput, load_checkpoint, save_checkpoint
from runtime.errors import CheckpointError, InputError
from training.batch import Batch
from training.datasets.sample import SampleSource
from training.distributed import Processes, join_processes, share_gradients
from training.evaluation.pictures import draw_pictures
from training.evaluation.scoring import score_sources, torch_predict
from training.lidar.split import LidarInput
from training.loading.batches import read_batches
from training.losses import SSDNetLoss
from training.network import train_parts
from training.optimizer import build_optimizer, exponential_average, learning_rate
from training.progress import Progress
from training.recipe import LoopRecipe, Recipe
from training.release import release_weights
from training.run_folder import (
    BEST,
    FINAL,
    LAST,
    SCORES,
    TENSORBOARD,
    name_weights,
    prepare_folder,
    require_finite,
    require_same,
)
from training.score_table import SHOWN, ScoreTable
from training.task import open_task

#: `Network.forward`, perhaps distributed.
Forward = Callable[..., NetworkOutput]

#: The recipe's names of types other than float32.
_AUTOCAST = {"bf16": torch.bfloat16, "fp16": torch.float16}


def train(
    recipe: Recipe,
    *,
    data: Sequence[Path],
    out: Path,
    init: Path | None = None,
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Path:
    """Train a network by a recipe.

    Writes to ``out``: recipe.json (resolved), last.pt (to resume from), model.pt (the averaged
    weights, to release), best.pt (those of the best validation so far), scores.csv (every score of
    every validation) and tensorboard/. An ``out`` with a last.pt of the same recipe is resumed.
    Started by torchrun, each process takes its share of every batch, see `training.distributed`;
    the first one writes, and all stop at the same step.

    Args:
        recipe: what to train and how.
        data: folders with the recipe's data sets.
        out: folder of the run.
        init: a checkpoint to start from; weights that do not fit are initialised as usual.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step; the run can be resumed.
        stop: called between two steps; True stops the run, which can be resumed.

    Returns:
        model.pt, or last.pt if the run was stopped early.

    Raises:
        InputError: if the recipe, the device or ``out`` cannot be used, for example an ``out`` of
            another recipe.
        DatasetError: if a data set is missing or damaged.
        CheckpointError: if a checkpoint cannot be read or written.
        NonFiniteLossError: if the loss or its gradient is NaN or infinite.
    """
    with join_processes(device) as processes:
        return _train(recipe, processes, data, out, init, stop_after, stop)


def _train(
    recipe: Recipe,
    processes: Processes,
    data: Sequence[Path],
    out: Path,
    init: Path | None,
    stop_after: int | None,
    stop: Callable[[], bool],
) -> Path:
    task = open_task(recipe, processes, data, init)
    network, criterion = task.network, task.criterion
    resolved = {
        "recipe": asdict(recipe),
        "init": None if init is None else name_weights(init),
        "processes": processes.count,
    }
    if processes.is_first:
        prepare_folder(out, resolved)  # only now: a training that cannot start leaves no folder
    processes.wait()
    optimizer = build_optimizer(recipe.optimizer, network, criterion)
    scaler = torch.amp.GradScaler(processes.device.type, enabled=recipe.loop.autocast == "fp16")
    # Buffers are averaged too: batch statistics must fit the averaged weights.
    average = AveragedModel(
        network, multi_avg_fn=exponential_average(recipe.loop.ema_decay), use_buffers=True
    )
    averaged: Network = average.module  # type: ignore[assignment]
    # The state of a resumed run, beside the network and the step.
    parts: dict[str, Any] = {
        "optimizer": optimizer,
        "average": average,
        "criterion": criterion,
        "scaler": scaler,
    }
    step = _resume(out / LAST, resolved, network, parts)
    if len(set(processes.gather(step))) > 1:
        raise InputError(
            f"{out}: the processes find different checkpoints in it. Give an --out on a file "
            "system that all machines share."
        )
    if step == recipe.schedule.steps and (out / FINAL).is_file():
        return out / FINAL
    forward: Forward = share_gradients(network, processes)

    training_info = {
        "data": [item.title for item in recipe.data.source],
        "terms": recipe.terms,
        "trained_height": recipe.model.trained_height,
        **resolved,
    }

    def save_last() -> None:
        if processes.is_first:
            states = {name: part.state_dict() for name, part in parts.items()}
            info = {**training_info, "step": step}
            save_checkpoint(out / LAST, network, training=info, trainer={"step": step, **states})

    def save_released(path: Path, candidate: Network) -> None:
        save_checkpoint(path, candidate, training={**training_info, "step": step})

    scores = ScoreTable(out / SCORES, step) if processes.is_first else None
    steps = recipe.schedule.steps
    last_step = steps if stop_after is None else min(steps, stop_after)
    with (
        _Board(out / TENSORBOARD if processes.is_first else None, step) as board,
        closing(Progress(steps, step, shown=processes.is_first)) as progress,
        read_batches(recipe, task, processes, step) as batches,
    ):
        train_parts(network, recipe.optimizer.only)
        while step < last_step and not processes.any(stop()):
            rate = learning_rate(recipe.schedule, recipe.optimizer.learning_rate, step)
            for group in optimizer.param_groups:
                group["lr"] = rate
            optimizer.zero_grad(set_to_none=True)
            sums: dict[str, Tensor] = {}
            names: list[str] = []
            for _ in range(recipe.loop.accumulate):
                batch = next(batches).to(processes.device)
                names += batch.names
                terms = _compute_loss(forward, criterion, batch, recipe.loop)
                require_finite(terms, terms["total"], step, names, out, processes)
                share = terms["total"] / recipe.loop.accumulate
                scaler.scale(share).backward()  # type: ignore[no-untyped-call]
                for name, term in terms.items():
                    sums[name] = sums.get(name, 0.0) + term.detach() / recipe.loop.accumulate
            scaler.unscale_(optimizer)
            norm = torch.nn.utils.get_total_norm(
                [p.grad for p in network.parameters() if p.grad is not None]
            )
            if not scaler.is_enabled():  # the scaler skips a step that overflows
                require_finite(sums, norm, step, names, out, processes)
            if recipe.loop.clip_norm:
                torch.nn.utils.clip_grads_with_norm_(
                    network.parameters(), recipe.loop.clip_norm, norm
                )
            scaler.step(optimizer)
            scaler.update()
            average.update_parameters(network)
            step += 1
            progress.update(step, sums["total"], rate)

            if step % recipe.log_every == 0:
                board.add_scalars(
                    {
                        **{f"loss/{name}": term.item() for name, term in sums.items()},
                        **{
                            f"log_variance/{name}": value.item()
                            for name, value in criterion.log_variances.items()
                        },
                        "learning_rate": rate,
                    },
                    step,
                )
            # Before the checkpoint: a run killed in between validates again after it resumes.
            if task.validation and (step % recipe.validate_every == 0 or step == steps):
                candidate = release_weights(averaged, task.release)
                figures = _validate(candidate, task.validation, recipe, processes, board, step)
                if scores is not None and scores.add(step, figures, recipe.validation.best):
                    save_released(out / BEST, candidate)
                train_parts(network, recipe.optimizer.only)
            if step % recipe.checkpoint_every == 0:
                save_last()
    save_last()
    if step == steps and processes.is_first:
        save_released(out / FINAL, release_weights(averaged, task.release))
    processes.wait()  # until the file is written
    return out / (FINAL if step == steps else LAST)  # stopped early: nothing to release yet


class _Board:
    """TensorBoard, or nothing in processes that do not write."""

    def __init__(self, folder: Path | None, step: int) -> None:
        # Entries of later steps, of an interrupted run, are removed.
        purge = step + 1 if step else None
        self._writer = None if folder is None else SummaryWriter(str(folder), purge_step=purge)

    def __enter__(self) -> "_Board":
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def add_scalars(self, values: Mapping[str, float], step: int) -> None:
        for name, value in values.items():
            if self._writer is not None:
                self._writer.add_scalar(name, value, step)

    def add_picture(self, name: str, rgb: np.ndarray, step: int) -> None:
        if self._writer is not None:
            self._writer.add_image(name, rgb, step, dataformats="HWC")


def _validate(
    network: Network,
    sources: Mapping[str, SampleSource],
    recipe: Recipe,
    processes: Processes,
    board: _Board,
    step: int,
) -> dict[str, dict[str, float]]:
    """Score the network, each process on its share of the frames; show scores and pictures."""
    lidar = LidarInput.parse(recipe.validation.lidar)
    scores = score_sources(network, sources, processes, lidar=lidar)
    shown = {
        f"{name}/{key}": figures[key]
        for name, figures in scores.items()
        for key in SHOWN
        if key in figures
    }
    board.add_scalars({f"validation/{name}": score for name, score in shown.items()}, step)
    if not processes.is_first:
        return scores
    text = ", ".join(f"{name} {score:.4f}" for name, score in shown.items())
    tqdm.write(f"step {step}: {text}", file=sys.stderr)
    for name, source in sources.items():
        pictures = draw_pictures(
            torch_predict(network),
            source,
            network,
            lidar=lidar,
            count=recipe.validation.pictures,
        )
        for frame, picture in pictures:
            board.add_picture(f"{name}/{frame}", picture, step)
    return scores


def _compute_loss(
    forward: Forward, criterion: SSDNetLoss, batch: Batch, loop: LoopRecipe
) -> dict[str, Tensor]:
    rgb = batch.rgb.float().to(memory_format=torch.channels_last)
    with torch.autocast(
        rgb.device.type,
        dtype=_AUTOCAST.get(loop.autocast),
        enabled=loop.autocast in _AUTOCAST,
    ):
        output = forward(
            rgb, batch.sparse_depth, upsample_semantic=criterion.config.semantic_grid == "image"
        )
    terms: dict[str, Tensor] = criterion(output, batch)
    return terms


def _resume(
    path: Path,
    resolved: Mapping[str, Any],
    network: Network,
    parts: Mapping[str, Any],
) -> int:
    """Load the state of the run if there is one; return the step to resume from."""
    if not path.is_file():
        return 0
    checkpoint = load_checkpoint(path)
    require_same(checkpoint.training, resolved, path)
    network.load_state_dict(checkpoint.model.state_dict())
    try:
        for name, part in parts.items():
            part.load_state_dict(checkpoint.trainer[name])
        return int(checkpoint.trainer["step"])
    except Exception as error:  # a damaged state can fail in any way
        raise CheckpointError(
            f"{path}: its state of the loop is damaged ({error!r:.200}), so it cannot be resumed. "
            "Start a new --out with --init and this file."
        ) from error
