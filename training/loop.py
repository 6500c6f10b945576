"""The training loop: one flat function from a recipe to checkpoints."""

import json
import math
import random
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from models import SSDNet, create_model, load_checkpoint, save_checkpoint
from runtime.errors import CheckpointError, InputError, SSDNetError
from runtime.writer import write_whole
from training.evaluation.scoring import score_sources
from training.losses import SSDNetLoss, class_weights
from training.recipe import OptimizerRecipe, Recipe, ScheduleRecipe
from training.sources import count_pixels, open_mixture, open_source

#: What AveragedModel hands to its update rule.
Tensors = tuple[Tensor, ...] | list[Tensor]

LAST = "last.pt"
FINAL = "model.pt"
NON_FINITE = "non_finite.json"


class NonFiniteLossError(SSDNetError):
    """The loss became NaN or infinite; names the step and the file with the frames."""


def train(
    recipe: Recipe,
    *,
    data: Sequence[Path],
    out: Path,
    init: Path | None = None,
    device: str = "cpu",
    stop_after: int | None = None,
) -> Path:
    """Train as the recipe says and return the path of the final checkpoint, model.pt.

    Writes ``out``: recipe.json (resolved), last.pt (to resume from), model.pt (the averaged
    weights, to ship) and tensorboard/. An ``out`` with a last.pt of the same recipe goes on where
    it stopped; of another recipe it is an InputError. ``init`` starts from another checkpoint's
    weights, as far as they fit. ``stop_after`` ends early at that step, resumable, and returns
    last.pt.
    """
    resolved = {"recipe": asdict(recipe), "init": _weights_name(init)}
    # OpenCV's thread pool does not survive the fork of the loader's workers: they would hang.
    cv2.setNumThreads(0)
    torch.manual_seed(recipe.data.seed)
    random.seed(recipe.data.seed)
    np.random.seed(recipe.data.seed)  # noqa: NPY002  (for libraries that draw from it)

    sources = [open_source(item, data) for item in recipe.data.source]
    validation = {item.path: open_source(item, data) for item in recipe.validation.source}
    network = _build_network(recipe, init)
    try:
        network = network.to(device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device {device!r} cannot be had: {error}. Try --device cpu.") from error
    if recipe.loop.channels_last:
        network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    weights = None
    if network.config.semantic_head:
        counts = count_pixels(recipe.data, sources, network.config.num_classes)
        weights = class_weights(torch.from_numpy(counts), recipe.loss.class_weighting)
    _claim(out, resolved)  # only now: what cannot start leaves no folder behind
    criterion = SSDNetLoss(recipe.loss, weights, max_depth_m=network.config.max_depth_m).to(device)
    optimizer = _build_optimizer(recipe.optimizer, network, criterion)
    # Buffers are averaged too: batch statistics must fit the averaged weights.
    average = AveragedModel(
        network, multi_avg_fn=exponential_average(recipe.loop.ema_decay), use_buffers=True
    )
    averaged: SSDNet = average.module  # type: ignore[assignment]
    step = _resume(out / LAST, network, average, optimizer, criterion)

    steps, batch, parts = recipe.schedule.steps, recipe.data.batch_size, recipe.loop.accumulate
    mixture = open_mixture(recipe.data, sources, length=steps * parts * batch)
    loader = DataLoader(
        mixture,
        batch_size=batch,
        sampler=range(step * parts * batch, steps * parts * batch),
        num_workers=recipe.data.workers,
        prefetch_factor=3 if recipe.data.workers else None,
        pin_memory=device != "cpu",
    )
    training_info = {
        "data": [item.path for item in recipe.data.source],
        "terms": recipe.terms,
        **resolved,
    }

    def save(path: Path, *, resumable: bool) -> None:
        shipped = adjust_logits(averaged.state_dict(), weights, recipe.loop.logit_adjustment)
        save_checkpoint(
            path,
            network,
            training={**training_info, "step": step},
            state_dict=network.state_dict() if resumable else shipped,
            trainer=(
                {
                    "step": step,
                    "optimizer": optimizer.state_dict(),
                    "average": average.state_dict(),
                    "criterion": criterion.state_dict(),
                }
                if resumable
                else None
            ),
        )

    last_step = steps if stop_after is None else min(steps, stop_after)
    with (
        SummaryWriter(str(out / "tensorboard"), purge_step=step) as board,
        tqdm(total=steps, initial=step, desc="train", unit="step", disable=None) as progress,
    ):
        network.train()
        batches = iter(loader)
        while step < last_step:
            rate = learning_rate(recipe.schedule, recipe.optimizer.learning_rate, step)
            for group in optimizer.param_groups:
                group["lr"] = rate
            optimizer.zero_grad(set_to_none=True)
            for _ in range(parts):
                samples = next(batches)
                terms = _compute_loss(network, criterion, samples, recipe, device)
                _require_finite(terms, step, samples["name"], out / NON_FINITE)
                (terms["total"] / parts).backward()  # type: ignore[no-untyped-call]
            if recipe.loop.clip_norm:
                torch.nn.utils.clip_grad_norm_(network.parameters(), recipe.loop.clip_norm)
            optimizer.step()
            average.update_parameters(network)
            step += 1
            progress.update()

            if step % recipe.loop.log_every == 0:
                for name, value in terms.items():
                    board.add_scalar(f"loss/{name}", value.item(), step)
                for name, log_variance in criterion.log_variances.items():
                    board.add_scalar(f"log_variance/{name}", log_variance.item(), step)
                board.add_scalar("learning_rate", rate, step)
                progress.set_postfix(loss=f"{terms['total'].item():.3f}")
            if step % recipe.loop.checkpoint_every == 0:
                save(out / LAST, resumable=True)
            if validation and (step % recipe.validation.every == 0 or step == steps):
                scores = score_sources(averaged, validation)
                for name, score in scores.items():
                    board.add_scalar(f"validation/{name}", score, step)
                text = ", ".join(f"{name} {score:.4f}" for name, score in scores.items())
                tqdm.write(f"step {step}: {text}", file=sys.stderr)
                network.train()
    save(out / LAST, resumable=True)
    if step < steps:  # stopped early: nothing to ship yet
        return out / LAST
    save(out / FINAL, resumable=False)
    return out / FINAL


def learning_rate(schedule: ScheduleRecipe, peak: float, step: int) -> float:
    """Rate of a step: linear warm-up from 0, then cosine down to its final share, or constant."""
    if step < schedule.warmup_steps:
        return peak * (step + 1) / schedule.warmup_steps
    if schedule.shape == "constant":
        return peak
    progress = (step - schedule.warmup_steps) / max(1, schedule.steps - schedule.warmup_steps)
    share = 0.5 * (1 + math.cos(math.pi * min(1.0, progress)))
    return peak * (schedule.final_ratio + (1 - schedule.final_ratio) * share)


def exponential_average(
    decay: float,
) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """Return AveragedModel's update rule: an exponential average that forgets its start.

    The decay grows as (1 + n) / (10 + n) up to ``decay``: with the full decay from the first step
    a short run would still carry a good part of its random start.
    """

    @torch.no_grad()
    def update(average: Tensors, current: Tensors, count: Tensor | int) -> None:
        share = 1.0 - min(decay, (1.0 + int(count)) / (10.0 + int(count)))
        if average[0].is_floating_point():
            torch._foreach_lerp_(average, current, share)
        else:  # counters
            torch._foreach_copy_(average, current)

    return update


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
        adjusted["semantic_head.bias"] = bias - share * weights.to(bias).log()
    return adjusted


def _compute_loss(
    network: SSDNet,
    criterion: SSDNetLoss,
    samples: Mapping[str, Any],
    recipe: Recipe,
    device: str,
) -> dict[str, Tensor]:
    rgb = samples["rgb"].to(device, non_blocking=True).float()
    sparse_depth = samples["sparse_depth"].to(device, non_blocking=True)
    if recipe.loop.channels_last:
        rgb = rgb.to(memory_format=torch.channels_last)
    with torch.autocast(
        rgb.device.type, dtype=torch.bfloat16, enabled=recipe.loop.autocast == "bf16"
    ):
        output = network(rgb, sparse_depth)
    terms: dict[str, Tensor] = criterion(
        output,
        samples["semantic"].to(device, non_blocking=True),
        samples["depth"].to(device, non_blocking=True),
        semantic_weight=samples["semantic_weight"].to(device, non_blocking=True),
    )
    return terms


def _require_finite(
    terms: Mapping[str, Tensor], step: int, names: Sequence[str], path: Path
) -> None:
    """Stop on a loss that is NaN or infinite; its terms and frames are saved to ``path``."""
    if torch.isfinite(terms["total"]):
        return
    # Text: JSON has no NaN.
    values = {name: str(term.item()) for name, term in terms.items()}
    document = {"step": step, "terms": values, "frames": list(names)}
    write_whole(path, json.dumps(document, indent=2).encode())
    raise NonFiniteLossError(
        f"step {step}: the loss is {values['total']}; its terms and the {len(names)} frames of its "
        f"batch are in {path}. Lower the learning rate or look at them; the same command goes on "
        "from the last checkpoint."
    )


def _build_network(recipe: Recipe, init: Path | None) -> SSDNet:
    try:
        network = create_model(recipe.model.name, max_depth_m=recipe.model.max_depth_m)
    except ValueError as error:
        raise InputError(f"the recipe's model cannot be built: {error}.") from error
    if init is not None:
        _start_from(network, init)
    return network


def _start_from(network: SSDNet, init: Path) -> None:
    """Take over the weights of a checkpoint; layers that it lacks, or has in another shape, stay.

    So a network with other classes or another head starts from what is already known. What
    starts anew is said on standard error. Raises CheckpointError if nothing fits.
    """
    known = load_checkpoint(init).model.state_dict()
    wanted = network.state_dict()
    taken = {
        name: known[name]
        for name, value in wanted.items()
        if name in known and known[name].shape == value.shape
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


def _build_optimizer(
    recipe: OptimizerRecipe, network: SSDNet, criterion: SSDNetLoss
) -> torch.optim.Optimizer:
    # Biases, normalisation and what the loss learns are not decayed.
    kernels = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    others += criterion.parameters()
    groups: list[dict[str, Any]] = [
        {"params": kernels, "weight_decay": recipe.weight_decay},
        {"params": others, "weight_decay": 0.0},
    ]
    if recipe.name == "sgd":
        return torch.optim.SGD(groups, lr=recipe.learning_rate, momentum=recipe.momentum)
    return torch.optim.AdamW(groups, lr=recipe.learning_rate)


def _claim(out: Path, resolved: Mapping[str, Any]) -> None:
    """Make ``out`` this training's folder, or say that it is another's."""
    path = out / "recipe.json"
    text = json.dumps(resolved, indent=2, default=str)
    try:
        if path.is_file():
            if path.read_text(encoding="utf-8") != text:
                raise InputError(
                    f"{out}: holds a training with another recipe (see its recipe.json). "
                    "Choose another --out, or the recipe it was started with."
                )
            for unfinished in out.glob(".*.pt.*"):  # a run was killed while it wrote
                unfinished.unlink()
            return
        out.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written: {error.strerror}. Choose another --out."
        ) from error


def _resume(
    path: Path,
    network: SSDNet,
    average: AveragedModel,
    optimizer: torch.optim.Optimizer,
    criterion: SSDNetLoss,
) -> int:
    """Load the loop's state if there is one; return the step to go on from."""
    if not path.is_file():
        return 0
    checkpoint = load_checkpoint(path)
    if not checkpoint.trainer:
        raise CheckpointError(f"{path}: holds no optimiser state, so it cannot be resumed.")
    network.load_state_dict(checkpoint.model.state_dict())
    average.load_state_dict(checkpoint.trainer["average"])
    optimizer.load_state_dict(checkpoint.trainer["optimizer"])
    criterion.load_state_dict(checkpoint.trainer["criterion"])
    return int(checkpoint.trainer["step"])


def _weights_name(init: Path | None) -> str | None:
    return None if init is None else init.name
