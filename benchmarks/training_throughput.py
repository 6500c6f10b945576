"""Training speed: images/s of the loader, of the step, of both together, and with two processes.

    python benchmarks/training_throughput.py RECIPE.toml --data DIR [--set 'model.name = "ssdnet"']
        [--device cpu] [--seconds 40] [--workers 1 2] [--processes 1 2]

The loader is run alone (after some batches to warm up), the step alone (forward, loss, backward,
clipping, update and averaging on batches that are already there), then the loop as it is, whose
waiting for the next batch is timed. Each figure is images over seconds of one stretch of
`--seconds`; CPU time is that of all threads, and of a loader only where it has no process of its
own (0 workers). On a shared machine compare CPU times, of stretches that alternate. To compare two
revisions, run the script of each in its own working tree with that tree on PYTHONPATH.
With two processes each computes on half of the threads. `--processes 0` leaves the loop out.
"""

import argparse
import itertools
import json
import os
import platform
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import torch
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader

from runtime.engine_facts import cpu_name
from training import loop
from training.loading.open_dataset import open_dataset, open_mixture
from training.losses import SSDNetLoss
from training.network import build_network, train_parts
from training.optimizer import build_optimizer, exponential_average
from training.recipe import Recipe, read_recipe


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recipe", type=Path)
    parser.add_argument("--data", type=Path, action="append", required=True)
    parser.add_argument("--set", action="append", default=[], help="'table.key = value' in TOML")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=40.0, help="length of each stretch")
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    recipe = read_recipe(arguments.recipe, arguments.set)
    cv2.setNumThreads(0)
    if arguments.child:
        figures = time_loop(recipe, arguments, arguments.child.parent / "run")
        if os.environ.get("RANK", "0") == "0":
            arguments.child.write_text(json.dumps(figures))
        return
    torch.set_num_threads(arguments.threads)
    crop = "x".join(map(str, recipe.data.augment.crop))
    print(
        f"{recipe.model.name}, {crop}, batches of {recipe.data.batch_size}, "
        f"{recipe.loop.autocast}; {cpu_name()}, {arguments.threads} threads, device "
        f"{arguments.device}, torch {torch.__version__}, Python {platform.python_version()}\n"
    )
    print("| what | images/s | CPU ms an image | waiting for data |")
    print("|---|---|---|---|")
    for workers in arguments.workers:
        rate, cpu_ms = time_loader(recipe, arguments, workers)
        shown = "" if workers else f"{cpu_ms:.1f}"
        print(f"| loader alone, {workers} workers | {rate:.1f} | {shown} | |", flush=True)
    rate, cpu_ms = time_step(recipe, arguments)
    print(f"| step alone | {rate:.1f} | {cpu_ms:.1f} | |", flush=True)
    for count in filter(None, arguments.processes):
        figures = run_processes(arguments, count)
        print(
            f"| loop, {count} process{'es' * (count > 1)} | {figures['rate']:.1f} | | "
            f"{figures['waiting']:.1%} |",
            flush=True,
        )


def make_batches(recipe: Recipe, arguments: argparse.Namespace, workers: int) -> Iterator[dict]:
    """Batches as the loop draws them."""
    sources = [
        open_dataset(item, arguments.data, classes=recipe.model.class_table)
        for item in recipe.data.source
    ]
    data = replace(recipe.data, workers=workers)
    mixture = open_mixture(data, sources, length=1_000_000)
    return iter(
        DataLoader(
            mixture,
            batch_size=data.batch_size,
            num_workers=workers,
            prefetch_factor=3 if workers else None,
        )
    )


def repeat(work: Callable[[], int], seconds: float) -> tuple[float, float]:
    """Images a second of work that returns how many it did, and its CPU time an image [ms]."""
    count, started, cpu = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - started < seconds:
        count += work()
    return count / (time.perf_counter() - started), (time.process_time() - cpu) / count * 1e3


def time_loader(recipe: Recipe, arguments: argparse.Namespace, workers: int) -> tuple[float, float]:
    """`repeat` of the loader with nothing else to do."""
    batches = make_batches(recipe, arguments, workers)
    for _ in range(4 * max(1, workers)):
        next(batches)  # prefetched before the clock
    return repeat(lambda: len(next(batches)["name"]), arguments.seconds)


def time_step(recipe: Recipe, arguments: argparse.Namespace) -> tuple[float, float]:
    """`repeat` of what the loop does with a batch that is in memory."""
    device = torch.device(arguments.device)
    drawn = make_batches(recipe, arguments, 0)
    batches = itertools.cycle([next(drawn) for _ in range(2)])
    network = build_network(recipe.model, None).to(device)
    train_parts(network, recipe.optimizer.only)
    if recipe.loop.channels_last:
        network = network.to(memory_format=torch.channels_last)
    criterion = SSDNetLoss(recipe.loss, None, max_depth_m=recipe.model.max_depth_m).to(device)
    optimizer = build_optimizer(recipe.optimizer, network, criterion)
    average = AveragedModel(
        network, multi_avg_fn=exponential_average(recipe.loop.ema_decay), use_buffers=True
    )

    def step() -> int:
        optimizer.zero_grad(set_to_none=True)
        terms = loop._compute_loss(network, criterion, next(batches), recipe.loop, device)
        terms["total"].backward()
        gradients = [p.grad for p in network.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm(gradients)
        if recipe.loop.clip_norm:
            torch.nn.utils.clip_grads_with_norm_(network.parameters(), recipe.loop.clip_norm, norm)
        optimizer.step()
        average.update_parameters(network)
        if device.type == "cuda":
            torch.cuda.synchronize()
        return recipe.data.batch_size

    step()
    return repeat(step, arguments.seconds)


def run_processes(arguments: argparse.Namespace, count: int) -> dict[str, float]:
    """Run the loop itself in so many processes and return the first one's figures."""
    with tempfile.TemporaryDirectory() as scratch:
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            port = probe.getsockname()[1]
        launcher = ["-m", "torch.distributed.run", f"--nproc-per-node={count}"]
        launcher += [f"--master-port={port}"]
        command = [sys.executable, "-W", "ignore", *(launcher if count > 1 else [])]
        result = Path(scratch) / "figures.json"
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": str(max(1, arguments.threads // count)),
        }
        done = subprocess.run(
            [*command, __file__, *sys.argv[1:], "--child", str(result)],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        if done.returncode:
            sys.exit(done.stderr[-3000:])
        return json.loads(result.read_text())


def time_loop(recipe: Recipe, arguments: argparse.Namespace, out: Path) -> dict[str, float]:
    """Train for a while and watch: images a second of all processes, share of waiting."""
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    waited: list[float] = []
    moments: list[float] = []

    class TimedLoader(DataLoader):
        def __iter__(self) -> Iterator:
            batches = super().__iter__()
            while True:
                asked = time.perf_counter()
                batch = next(batches)
                moments.append(time.perf_counter())
                waited.append(moments[-1] - asked)
                yield batch

    loop.DataLoader = TimedLoader
    probe = replace(
        recipe,
        schedule=replace(recipe.schedule, steps=100_000, warmup_steps=0),
        loop=replace(recipe.loop, checkpoint_every=1_000_000),
        validation=replace(recipe.validation, source=()),
    )
    warm = 6
    steps = warm + 4
    loop.train(probe, data=arguments.data, out=out, device=arguments.device, stop_after=steps)
    pace = (moments[-1] - moments[warm]) / (steps - 1 - warm)
    steps += max(4, int(arguments.seconds / pace))
    waited.clear()
    moments.clear()
    loop.train(probe, data=arguments.data, out=out, device=arguments.device, stop_after=steps)
    span = moments[-1] - moments[warm]
    images = (len(moments) - 1 - warm) * recipe.data.batch_size * processes
    return {"rate": images / span, "waiting": sum(waited[warm + 1 :]) / span}


if __name__ == "__main__":
    main()
