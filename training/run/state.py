"""The state of a training, as last.pt keeps it: network, optimiser and averaged weights."""

import copy
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from models import Network, NetworkOutput, load_checkpoint, save_checkpoint
from models.answers import head_maps
from runtime.base.arguments import shown
from runtime.base.errors import CheckpointError, InputError, SSDNetError
from runtime.files.atomic_write import atomic_write
from training.base.processes import share_network
from training.loading.batch import Batch
from training.run.optimizer import learning_rate
from training.run.task import Task

# `Network.forward`, or its distributed wrapper.
Forward = Callable[..., NetworkOutput]

_NON_FINITE = "non_finite.json"


# Arguments of AveragedModel's update rule.
Tensors = tuple[Tensor, ...] | list[Tensor]


class NonFiniteLossError(SSDNetError):
    """The loss is NaN or infinite; the message names the step and the file with the frames."""


class Step(NamedTuple):
    """Outcome of a step: terms of the loss, averaged over its batches, and the learning rate."""

    terms: dict[str, Tensor]
    rate: float


class TrainingState:
    """Network, loss, optimiser and averaged weights at a step.

    Args:
        task: what it trains on what.
    """

    def __init__(self, task: Task) -> None:
        self.step = 0
        self._task, self._recipe, self._processes = task, task.recipe, task.processes
        self._network, self.criterion, self._teacher = task.network, task.criterion, task.teacher
        self._optimizer = task.optimizer
        self._peaks = [group["lr"] for group in task.optimizer.param_groups]
        # Buffers are averaged too: batch statistics must fit the averaged weights.
        loop = task.recipe.loop
        update = exponential_average(loop.ema_decay, keeps_start=loop.ema_keeps_start)
        self._average = AveragedModel(task.network, multi_avg_fn=update, use_buffers=True)
        self._forward = share_network(task.network, task.processes)

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
        }

    def resume(self, path: Path) -> None:
        """Load the state of the run if there is one."""
        if path.is_file():
            checkpoint = load_checkpoint(path)
            self._network.load_state_dict(checkpoint.model.state_dict())
            try:
                for name, part in self._parts.items():
                    part.load_state_dict(checkpoint.trainer[name])
                self.step = int(checkpoint.trainer["step"])
            except Exception as error:  # a damaged state can fail in any way
                raise CheckpointError(
                    f"{path}: its state of the loop is damaged ({shown(error, 200)}), so it cannot "
                    "be resumed: start a new --out with --init and this file"
                ) from error
        if len(set(self._processes.gather(self.step))) > 1:
            raise InputError(
                f"{path.parent}: the processes find different checkpoints in it: give an --out on "
                "a file system that all machines share"
            )

    def save(self, path: Path, training: Mapping[str, Any]) -> None:
        """Write the state, to resume from; the first process does."""
        if self._processes.is_first:
            states = {name: part.state_dict() for name, part in self._parts.items()}
            trainer = {"step": self.step, **states}
            save_checkpoint(path, self._network, training=training, trainer=trainer)

    def estimate_step_s(self) -> float:
        """Return about how long a step takes [s]; nothing changes.

        It is the time of the second of two forward and backward passes of a copy.
        """
        network, took_s = copy.deepcopy(self._network), 0.0
        crops, size = self._task.crops, self._task.data.augment.size
        inputs = [torch.zeros(crops, n, *size, device=self._processes.device) for n in (3, 1)]
        on_image = self.criterion.config.semantic_grid == "image"
        with torch.random.fork_rng():
            for _ in range(2):
                started = perf_counter()
                maps = head_maps(network(*inputs, upsample_semantic=on_image)).values()
                torch.stack([each.sum() for each in maps]).sum().backward()  # type: ignore[no-untyped-call]
                took_s = perf_counter() - started
        return took_s * self._recipe.loop.accumulate

    def advance(self, batches: Iterator[Batch]) -> Step:
        """Train one step on the next batches."""
        loop = self._recipe.loop
        for group, peak in zip(self._optimizer.param_groups, self._peaks, strict=True):
            group["lr"] = learning_rate(self._recipe.schedule, peak, self.step)
        self._optimizer.zero_grad(set_to_none=True)
        sums: dict[str, Tensor] = {}
        names: list[str] = []
        for _ in range(loop.accumulate):
            batch = next(batches).to(self._processes.device)
            names += batch.names
            if self._teacher is not None:
                with torch.no_grad():
                    batch = replace(batch, teacher=self._answer(self._teacher, batch))
            terms: dict[str, Tensor] = self.criterion(self._answer(self._forward, batch), batch)
            (terms["total"] / loop.accumulate).backward()  # type: ignore[no-untyped-call]
            for name, term in terms.items():
                sums[name] = sums.get(name, 0.0) + term.detach() / loop.accumulate
        parameters = list(self._network.parameters())
        norm = torch.nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None])
        if not (norm.isfinite() and sums["total"].isfinite()):
            raise self._diverged(sums, names)
        if loop.clip_norm:
            torch.nn.utils.clip_grads_with_norm_(parameters, loop.clip_norm, norm)
        self._optimizer.step()
        self._average.update_parameters(self._network)
        self.step += 1
        return Step(sums, self._optimizer.param_groups[0]["lr"])

    def _answer(self, network: Forward, batch: Batch) -> NetworkOutput:
        """Run a network in the recipe's arithmetic."""
        is_bf16 = self._recipe.loop.autocast == "bf16"
        with torch.autocast(batch.rgb.device.type, torch.bfloat16, enabled=is_bf16):
            return network(
                batch.rgb.float().to(memory_format=torch.channels_last),
                batch.sparse_depth,
                upsample_semantic=self.criterion.config.semantic_grid == "image",
            )

    def _diverged(self, terms: Mapping[str, Tensor], names: list[str]) -> NonFiniteLossError:
        """Write the terms and the frames of a step to a file; return the error that names it.

        Loss and gradient are the same in all processes, so that all raise it.
        """
        path = self._task.run.out / _NON_FINITE
        # Text: JSON has no NaN.
        values = {name: str(term.item()) for name, term in terms.items()}
        frames = [name for part in self._processes.gather(names) for name in part]
        if self._processes.is_first:
            document = {"step": self.step, "terms": values, "frames": frames}
            atomic_write(path, json.dumps(document, indent=2).encode())
        return NonFiniteLossError(
            f"step {self.step}: the loss ({values['total']}) or its gradient is not finite; the "
            f"terms and the {len(frames)} frames of the batch are in {path}: check them, or start "
            "a new --out with a lower optimizer.learning_rate"
        )


def exponential_average(
    decay: float, *, keeps_start: bool = False
) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """Return AveragedModel's update rule: an exponential average.

    Unless it `keeps_start`, the decay grows as (1 + n) / (10 + n) up to `decay`, so that the random
    initial weights do not remain in the average of a short run.
    """

    @torch.no_grad()
    def update(average: Tensors, current: Tensors, count: Tensor | int) -> None:
        growing = 1.0 if keeps_start else (1.0 + int(count)) / (10.0 + int(count))
        share = 1.0 - min(decay, growing)
        if average[0].is_floating_point():
            torch._foreach_lerp_(average, current, share)
        else:  # counters
            torch._foreach_copy_(average, current)

    return update
