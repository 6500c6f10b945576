"""The batches of a training, decoded and augmented by worker processes."""

import traceback
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import cv2
from torch.utils.data import DataLoader

from runtime.base.errors import DatasetError
from runtime.command.process import leave_signals_to_parent
from training.base.processes import Processes
from training.datasets.sample import SampleSource
from training.loading.batch import Batch
from training.loading.data_recipe import DataRecipe
from training.loading.mixture import CachedSource, Mixture, MixturePart
from training.run.task import Task


@contextmanager
def read_batches(task: Task, processes: Processes, step: int) -> Iterator[Iterator[Batch]]:
    """Yield this process's batches from a step to the end, and end the workers with the block.

    Workers ignore SIGTERM: while a traceback keeps the iterator, Python would wait for them at
    exit for ever.
    """
    recipe, batch = task.recipe, task.data.batch_size
    steps = recipe.schedule.steps
    per_step = recipe.loop.accumulate * batch * processes.count
    parts = _list_parts(task.data, task.sources)
    loader = DataLoader(
        Mixture(
            parts,
            length=steps * per_step,
            seed=task.data.seed,
            depth=task.depth_target,
            pair_step=task.pair_step,
            rare=recipe.rare_ids,
        ),
        batch_size=batch,
        sampler=processes.shares(step * per_step, steps * per_step, batch),
        num_workers=task.data.workers,
        prefetch_factor=3 if task.data.workers else None,
        pin_memory=processes.device.type == "cuda",
        worker_init_fn=_start_worker,
        collate_fn=partial(Batch.collate, targets=task.targets),
    )
    batches = _without_tracebacks(iter(loader))
    try:
        yield batches
    except BaseException as error:
        traceback.clear_frames(error.__traceback__)
        raise
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


def _start_worker(_: int) -> None:
    """Set up a worker process of the loader."""
    leave_signals_to_parent()
    # OpenCV's threads would compete with those of the training.
    cv2.setNumThreads(0)


def _without_tracebacks(batches: Iterator[Batch]) -> Generator[Batch, None, None]:
    """Yield the batches; a worker's error about a damaged file comes without its traceback."""
    try:
        yield from batches
    except DatasetError as error:
        traceback.clear_frames(error.__traceback__)
        last = str(error).strip().splitlines()[-1]
        raise DatasetError(last.removeprefix(f"{DatasetError.__module__}.DatasetError: ")) from None
