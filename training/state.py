"""The state of a training: all that a step changes, and that last.pt keeps."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from models import Network, NetworkOutput, load_checkpoint, save_checkpoint
from runtime.checks import shown
from runtime.errors import CheckpointError, InputError
from training.batch import Batch
from training.distributed import Processes, share_gradients
from training.losses import SSDNetLoss
from training.network import train_parts
from training.optimizer import build_optimizer, exponential_average, learning_rate
from training.recipe import LoopRecipe, Recipe
from training.run_folder import require_finite, require_same
from training.task import Task

#: `Network.forward`, or its distributed wrapper.
Forward = Callable[..., NetworkOutput]

#: Name in recipes -> dtype, besides float32.
_AUTOCAST = {"bf16": torch.bfloat16, "fp16": torch.float16}


class Step(NamedTuple):
    """Outcome of a step: terms of the loss, averaged over its batches, and the learning rate."""

    terms: dict[str, Tensor]
    rate: float


class TrainingState:
    """Network, loss, optimiser and averaged weights at a step.

    Args:
        recipe: the recipe.
        task: what it trains on what.
        processes: that train together.
        out: folder of the run, for errors.
    """

    def __init__(self, recipe: Recipe, task: Task, processes: Processes, out: Path) -> None:
        self.step = 0
        self._recipe, self._processes, self._out = recipe, processes, out
        self._network, self.criterion, self._teacher = task.network, task.criterion, task.teacher
        self._optimizer = build_optimizer(recipe.optimizer, task.network, task.criterion)
        self._peaks = [group["lr"] for group in self._optimizer.param_groups]
        is_fp16 = recipe.loop.autocast == "fp16"
        self._scaler = torch.amp.GradScaler(processes.device.type, enabled=is_fp16)
        # Buffers are averaged too: batch statistics must fit the averaged weights.
        update = exponential_average(recipe.loop.ema_decay)
        self._average = AveragedModel(task.network, multi_avg_fn=update, use_buffers=True)
        self._forward = share_gradients(task.network, processes)

    @property
    def averaged(self) -> Network:
        """The averaged weights."""
        network: Network = self._average.module  # type: ignore[assignment]
        return network

    @property
    def _parts(self) -> dict[str, Any]:
        """What last.pt keeps beside the network and the step."""
        return {
            "optimizer": self._optimizer,
            "average": self._average,
            "criterion": self.criterion,
            "scaler": self._scaler,
        }

    def resume(self, path: Path, resolved: Mapping[str, Any]) -> None:
        """Load the state of the run if there is one."""
        if path.is_file():
            checkpoint = load_checkpoint(path)
            require_same(checkpoint.training, resolved, path)
            self._network.load_state_dict(checkpoint.model.state_dict())
            try:
                for name, part in self._parts.items():
                    part.load_state_dict(checkpoint.trainer[name])
                self.step = int(checkpoint.trainer["step"])
            except Exception as error:  # a damaged state can fail in any way
                raise CheckpointError(
                    f"{path}: its state of the loop is damaged ({shown(error, 200)}), so it cannot "
                    "be resumed. Start a new --out with --init and this file."
                ) from error
        if len(set(self._processes.gather(self.step))) > 1:
            raise InputError(
                f"{path.parent}: the processes find different checkpoints in it. Give an --out on "
                "a file system that all machines share."
            )

    def save(self, path: Path, training: Mapping[str, Any]) -> None:
        """Write the state, to resume from; the first process does."""
        if self._processes.is_first:
            states = {name: part.state_dict() for name, part in self._parts.items()}
            trainer = {"step": self.step, **states}
            save_checkpoint(path, self._network, training=training, trainer=trainer)

    def advance(self, batches: Iterator[Batch]) -> Step:
        """Train one step on the next batches."""
        loop, scaler = self._recipe.loop, self._scaler
        optimizer = self._recipe.optimizer
        for group, peak in zip(self._optimizer.param_groups, self._peaks, strict=True):
            group["lr"] = learning_rate(self._recipe.schedule, peak, self.step)
        train_parts(self._network, optimizer.only, optimizer.frozen)
        self._optimizer.zero_grad(set_to_none=True)
        sums: dict[str, Tensor] = {}
        names: list[str] = []
        for _ in range(loop.accumulate):
            batch = next(batches).to(self._processes.device)
            names += batch.names
            if self._teacher is not None:
                with torch.no_grad():
                    taught = _answer(self._teacher, self.criterion, batch, loop)
                batch = replace(batch, teacher=taught)
            terms = _compute_loss(self._forward, self.criterion, batch, loop)
            self._require_finite(terms, terms["total"], names)
            scaler.scale(terms["total"] / loop.accumulate).backward()  # type: ignore[no-untyped-call]
            for name, term in terms.items():
                sums[name] = sums.get(name, 0.0) + term.detach() / loop.accumulate
        scaler.unscale_(self._optimizer)
        parameters = list(self._network.parameters())
        norm = torch.nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])
        if not scaler.is_enabled():  # the scaler skips a step that overflows
            self._require_finite(sums, norm, names)
        if loop.clip_norm:
            torch.nn.utils.clip_grads_with_norm_(parameters, loop.clip_norm, norm)
        scaler.step(self._optimizer)
        scaler.update()
        self._average.update_parameters(self._network)
        self.step += 1
        return Step(sums, self._optimizer.param_groups[0]["lr"])

    def _require_finite(self, terms: Mapping[str, Tensor], value: Tensor, names: list[str]) -> None:
        require_finite(terms, value, self.step, names, self._out, self._processes)


def _compute_loss(
    forward: Forward, criterion: SSDNetLoss, batch: Batch, loop: LoopRecipe
) -> dict[str, Tensor]:
    terms: dict[str, Tensor] = criterion(_answer(forward, criterion, batch, loop), batch)
    return terms


def _answer(
    network: Forward, criterion: SSDNetLoss, batch: Batch, loop: LoopRecipe
) -> NetworkOutput:
    kind = _AUTOCAST.get(loop.autocast)
    with torch.autocast(batch.rgb.device.type, dtype=kind, enabled=kind is not None):
        return network(
            batch.rgb.float().to(memory_format=torch.channels_last),
            batch.sparse_depth,
            upsample_semantic=criterion.config.semantic_grid == "image",
        )
