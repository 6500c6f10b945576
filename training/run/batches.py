"""The batches of a training, decoded and augmented by worker processes."""

import contextlib
import math
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import cv2
from torch.utils.data import DataLoader
from tqdm import tqdm

from runtime.base.errors import DatasetError, InputError
from runtime.command.process import leave_signals_to_parent
from training.base.own_code import is_of_loader
from training.datasets.sample import SampleSource
from training.loading.batch import Batch
from training.loading.data_recipe import DataRecipe
from training.loading.mixture import CachedSource, Mixture, MixturePart
from training.run.task import Task

# Batches that a worker reads ahead, and how long one may take [s].
_PREFETCHED, _PATIENCE_S = 3, 900
# Where workers leave batches on Linux, and about the bytes of a pixel: image, depth and targets.
_SHARED, _PIXEL_BYTES = "/dev/shm", 16


@contextmanager
def read_batches(task: Task, step: int) -> Iterator[Iterator[Batch]]:
    """Yield this process's batches from a step to the end, and end the workers with the block.

    Workers ignore SIGTERM: while a traceback keeps the iterator, Python would wait for them at
    exit for ever.
    """
    recipe, processes, batch = task.recipe, task.processes, task.data.batch_size
    steps = recipe.schedule.steps
    per_step = recipe.loop.accumulate * batch * processes.count
    parts = _list_parts(task.data, task.sources)
    workers = _fitting_workers(task)
    loader = DataLoader(
        Mixture(
            parts=parts,
            length=steps * per_step,
            seed=task.data.seed,
            depth=task.depth_target,
            pair_step=task.pair_step,
            rare=recipe.rare_ids,
        ),
        batch_size=batch,
        sampler=processes.shares(step * per_step, steps * per_step, batch),
        num_workers=workers,
        prefetch_factor=_PREFETCHED if workers else None,
        timeout=_PATIENCE_S if workers else 0,
        pin_memory=processes.device.type == "cuda",
        worker_init_fn=_start_worker,
        collate_fn=partial(Batch.collate, targets=task.targets),
    )
    batches = _without_tracebacks(iter(loader))
    try:
        yield batches
    except BaseException as error:
        traceback.clear_frames(error.__traceback__)
        if not is_of_loader(error):
            raise
        raise InputError(
            f"a process that reads the data has ended or hangs ({error}), mostly for want of "
            f"memory: the run resumes by the same command, from the last of its checkpoints, one "
            f"every {recipe.checkpoint_every} steps: lower data.workers or data.cache_gib by --set"
        ) from None
    finally:
        batches.close()  # the last reference to the loader's iterator, which ends its workers


def _list_parts(recipe: DataRecipe, sources: Sequence[SampleSource]) -> list[MixturePart]:
    """Return the sets with their weights and augmentation, each with its share of the cache."""
    share = recipe.cache_gib / (max(1, recipe.workers) * len(sources))
    return [
        MixturePart(
            CachedSource(source, limit_bytes=int(share * 2**30)) if share else source,
            item.weight,
            replace(recipe.augment, scale=item.scale) if item.scale else recipe.augment,
        )
        for item, source in zip(recipe.source, sources, strict=True)
    ]


def _fitting_workers(task: Task) -> int:
    """Return the number of workers; 0, and a warning, where shared memory cannot hold batches.

    A worker that cannot write to it prints an error and goes on, and the training would wait.
    """
    data = task.data
    if not data.workers or not os.path.isdir(_SHARED):
        return data.workers
    pixels = task.crops * math.prod(data.augment.size)
    needed = task.processes.count * data.workers * (_PREFETCHED + 1) * pixels * _PIXEL_BYTES
    free = shutil.disk_usage(_SHARED).free
    if needed <= free:
        return data.workers
    if task.processes.is_first:
        text = (
            f"warning: {_SHARED} has {free / 1e6:.3g} MB free, and the batches of {data.workers} "
        )
        text += f"workers need {needed / 1e6:.3g}: the training reads its data itself, which is "
        text += "slower: enlarge it (docker run --shm-size=2g), or lower data.workers"
        tqdm.write(text, file=sys.stderr)
    return 0


def _start_worker(_: int) -> None:
    """Set up a worker process of the loader."""
    leave_signals_to_parent()
    # OpenCV's threads would compete with those of the training.
    cv2.setNumThreads(0)


def _without_tracebacks(batches: Iterator[Batch]) -> Generator[Batch, None, None]:
    """Yield the batches; a worker's error about a file or a reader comes without its traceback."""
    try:
        yield from batches
    except (DatasetError, InputError) as error:
        traceback.clear_frames(error.__traceback__)
        kind, last = type(error), str(error).strip().splitlines()[-1]
        raise kind(last.removeprefix(f"{kind.__module__}.{kind.__name__}: ")) from None
    except (OSError, EOFError) as error:  # a worker was killed while it sent a batch
        with contextlib.suppress(ValueError):  # not the main thread, which alone has a handler
            # PyTorch's handler would raise a second time, while the loader ends its workers.
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        traceback.clear_frames(error.__traceback__)
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise RuntimeError(f"DataLoader lost a worker: {reason[-1]}") from None
