"""Distributed training: processes that torchrun started, each with its share of a batch.

Sums over processes are differentiable, and every loss divides a sum over all processes by a count
over all processes. So N processes with batches of B compute the same as one with a batch of N * B,
batch normalisation included.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from runtime.base.errors import InputError
from training.base.stop_signal import Stop, never

T = TypeVar("T")


@dataclass(frozen=True)
class Processes:
    """This process among those that train together, and its device."""

    rank: int
    count: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and shows progress."""
        return self.rank == 0

    def wait(self) -> None:
        """Wait for all processes."""
        if self.count > 1:
            dist.barrier()

    def any_of(self, flag: bool) -> bool:
        """Return whether the flag is set in any process; the same result in all of them."""
        if self.count == 1:
            return flag
        count = torch.tensor(int(flag), device=self.device)
        dist.all_reduce(count)
        return bool(count.item())

    def gather(self, item: T) -> list[T]:
        """Return the items of all processes in their order; plain Python objects."""
        if self.count == 1:
            return [item]
        items: list[Any] = [None] * self.count
        dist.all_gather_object(items, item)
        return items

    def own_stop(self, stop: Stop) -> Stop:
        """Return when this process may leave by itself; several stop together, at a step."""
        return stop if self.count == 1 else never

    def shares(self, first: int, last: int, batch_size: int) -> list[int]:
        """Return this process's samples of first..last - 1: one batch of each round.

        Every round of `count` batches is a contiguous range, so that it has the same samples
        whatever the number of processes.
        """
        return [
            index
            for start in range(first + self.rank * batch_size, last, self.count * batch_size)
            for index in range(start, start + batch_size)
        ]


def parse_device(text: str) -> torch.device:
    """Return the device that a command's --device names; InputError for another form."""
    if not re.fullmatch(r"cpu|cuda(:\d{1,3})?", text, re.ASCII):
        raise InputError(f"unknown device {text!r}: give --device cpu, cuda or cuda:N")
    return torch.device(text)


def open_device(text: str) -> torch.device:
    """Return the device of `parse_device`; InputError if PyTorch cannot use it."""
    device = parse_device(text)
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device {text!r} is not available: {error}: try --device cpu") from error
    return device


@contextmanager
def join_processes(device: str) -> Iterator[Processes]:
    """Join the processes that torchrun started, or be the only one.

    A nested block does not join a new group: runs that follow one another share the group.

    Args:
        device: "cpu" (gloo), "cuda" (nccl; each process of a machine takes its own GPU), or
            "cuda:N" for a single process.

    Raises:
        InputError: in the cases of `open_device`.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    place = open_device(device)
    if count > 1 and place.type == "cuda":
        place = open_device(f"cuda:{os.environ.get('LOCAL_RANK', '0')}")
    if count == 1:
        yield Processes(0, 1, place)
        return
    if dist.is_initialized():
        yield Processes(dist.get_rank(), count, place)
        return
    if place.type == "cuda":
        torch.cuda.set_device(place)
    dist.init_process_group("nccl" if place.type == "cuda" else "gloo")
    try:
        yield Processes(dist.get_rank(), count, place)
    finally:
        dist.destroy_process_group()


def sum_over_processes(x: Tensor) -> Tensor:
    """Sum a tensor over all processes, differentiably; with one process return it."""
    if not (dist.is_available() and dist.is_initialized()):
        return x
    total: Tensor = _SumOverProcesses.apply(x)  # type: ignore[no-untyped-call]
    return total


class _SumOverProcesses(torch.autograd.Function):
    """All-reduce whose gradient is the sum of the gradients of all processes."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        total = x.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        total = gradients[0].clone()
        dist.all_reduce(total)
        return total


def share_network(network: nn.Module, processes: Processes) -> nn.Module:
    """Wrap a network so that the processes train it like a single process with the large batch.

    Gradients are averaged over the processes; batch normalisation is over the batches of all
    processes, in `network` too.
    """
    if processes.count == 1:
        return network
    cuda = processes.device.type == "cuda"
    if cuda:
        nn.SyncBatchNorm.convert_sync_batchnorm(network)  # type: ignore[no-untyped-call]
    else:
        share_batch_norm(network)
    return DistributedDataParallel(
        network,
        device_ids=[processes.device.index] if cuda else None,
        broadcast_buffers=False,  # equal already: batch statistics are over all processes
        # Heads whose losses have weight 0 have no gradient.
        find_unused_parameters=True,
    )


def share_batch_norm(network: nn.Module) -> None:
    """Let a network normalise over the batches of all processes, on CPUs; in place."""
    for name, child in network.named_children():
        if isinstance(child, nn.BatchNorm2d):
            setattr(network, name, _SharedBatchNorm.of(child))
        else:
            share_batch_norm(child)


class _SharedBatchNorm(nn.BatchNorm2d):
    """Replacement of torch.nn.SyncBatchNorm, which does not support CPUs."""

    @classmethod
    def of(cls, norm: nn.BatchNorm2d) -> "_SharedBatchNorm":
        """Copy a batch normalisation with its buffers; the parameters stay the same objects."""
        shared = cls(norm.num_features, eps=norm.eps, momentum=norm.momentum)
        shared.load_state_dict(norm.state_dict())
        shared.weight, shared.bias = norm.weight, norm.bias
        return shared.train(norm.training)

    def forward(self, x: Tensor) -> Tensor:
        """Normalise (N, C, H, W) by the mean and variance over all processes."""
        running_mean, running_var, momentum = self.running_mean, self.running_var, self.momentum
        if not self.training or running_mean is None or running_var is None or momentum is None:
            return super().forward(x)
        values = x.float()
        over = (0, 2, 3)
        count = x.numel() // x.shape[1]
        sums = torch.cat([values.sum(over), values.new_tensor([count])])
        sums = sum_over_processes(sums)
        total = sums[-1].detach()
        mean = sums[:-1] / total
        centred = values - mean[:, None, None]
        variance = sum_over_processes(centred.square().sum(over)) / total
        with torch.no_grad():
            running_mean.lerp_(mean, momentum)
            running_var.lerp_(variance * total / (total - 1).clamp(min=1), momentum)
            if self.num_batches_tracked is not None:
                self.num_batches_tracked += 1
        scale = self.weight * torch.rsqrt(variance + self.eps)
        normalised = centred * scale[:, None, None] + self.bias[:, None, None]
        return normalised.to(x.dtype)
