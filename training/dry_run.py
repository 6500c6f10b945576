"""A training without its steps: whether it can start, and what it would be given."""

from collections.abc import Sequence
from pathlib import Path

from runtime.drawing.overlay import Overlay
from runtime.io.atomic_write import atomic_write
from runtime.io.encode import encode_png
from training.datasets.class_mapping import list_classes
from training.distributed import join_processes
from training.evaluation.pictures import draw_batch
from training.loading.batches import read_batches
from training.recipe import Recipe
from training.run_folder import BATCH, folder_errors
from training.task import open_task

#: Samples of the batch that are drawn.
_DRAWN = 8


def dry_run(
    recipe: Recipe, *, data: Sequence[Path], out: Path, init: Path | None = None, device: str
) -> Path:
    """Open all that a training needs and draw its first batch; arguments and errors as of `train`.

    Returns:
        batch.png, the only file that is written: ``out`` does not become a run's folder.
    """
    with join_processes(device) as processes:
        task = open_task(recipe, processes, data, init)
        with read_batches(recipe, task, processes, step=0) as batches:
            batch = next(batches)
        if processes.is_first:
            with folder_errors(out):
                out.mkdir(parents=True, exist_ok=True)
            overlay = Overlay(
                list_classes(recipe.model.class_table), task.network.config.max_depth_m
            )
            atomic_write(out / BATCH, encode_png(draw_batch(batch, overlay, count=_DRAWN)))
        processes.wait()
    return out / BATCH
