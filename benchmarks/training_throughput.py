"""Training speed: images/s of the loader, of the step, of both together, and with two processes.

    python benchmarks/training_throughput.py RECIPE.toml --data DIR [--set 'model.name = "ssdnet"']
        [--device cpu] [--seconds 40] [--workers 1 2] [--processes 1 2]

The loader is run alone (after some batches to warm up), the step alone (forward, loss, backward and
update on batches that are already there), then the loop as it is, whose waiting for the next batch
is timed. Each figure is images over seconds of one stretch of `--seconds`; on a shared machine
compare figures of one run.
With two processes each computes on half of the threads.
"""

import argparse
import json
import os
import platform
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import torch
from torch.utils.data import DataLoader

from runtime.stream.report import cpu_name
from training import loop
from training.loading.open_dataset import open_dataset, open_mixture
from training.losses import SSDNetLoss
from training.network import build_network
from training.optimizer import build_optimizer
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
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
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
    print("| what | images/s | waiting for data |")
    print("|---|---|---|")
    for workers in arguments.workers:
        rate = time_loader(recipe, arguments, workers)
        print(f"| loader alone, {workers} workers | {rate:.1f} | |", flush=True)
    print(f"| step alone | {time_step(recipe, arguments):.1f} | |", flush=True)
    for count in arguments.processes:
        figures = run_processes(arguments, count)
        print(
            f"| loop, {count} process{'es' * (count > 1)} | {figures['rate']:.1f} | "
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


def time_loader(recipe: Recipe, arguments: argparse.Namespace, workers: int) -> float:
    """Images a second of the loader with nothing else to do."""
    batches = make_batches(recipe, arguments, workers)
    for _ in range(4 * max(1, workers)):
        next(batches)  # prefetched before the clock
    started, count = time.perf_counter(), 0
    while time.perf_counter() - started < arguments.seconds:
        count += len(next(batches)["name"])
    return count / (time.perf_counter() - started)


def time_step(recipe: Recipe, arguments: argparse.Namespace) -> float:
    """Images a second of forward, loss, backward and update on batches in memory."""
    device = torch.device(arguments.device)
    drawn = make_batches(recipe, arguments, 0)
    batches = [next(drawn) for _ in range(2)]
    network = build_network(recipe.model, None).to(device)
    if recipe.loop.channels_last:
        network = network.to(memory_format=torch.channels_last)
    criterion = SSDNetLoss(recipe.loss, None, max_depth_m=recipe.model.max_depth_m).to(device)
    optimizer = build_optimizer(recipe.optimizer, network, criterion)

    def step(index: int) -> None:
        optimizer.zero_grad(set_to_none=True)
        terms = loop._compute_loss(network, criterion, batches[index % 2], recipe.loop, device)
        terms["total"].backward()
        optimizer.step()
        if device.type == "cuda":
            torch.cuda.synchronize()

    step(0)
    started, count = time.perf_counter(), 0
    while time.perf_counter() - started < arguments.seconds:
        step(count)
        count += 1
    return count * recipe.data.batch_size / (time.perf_counter() - started)


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
