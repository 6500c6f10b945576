"""A training without its steps: whether it can start, and the data that it would read."""

from collections.abc import Iterator, Sequence

import numpy as np

from runtime.contract.contract import NO_CLASS
from runtime.drawing.encode import encode_png
from runtime.drawing.overlay import Overlay
from runtime.files.atomic_write import atomic_write
from training.base.processes import join_processes
from training.datasets.class_mapping import list_classes
from training.datasets.sample import SampleSource
from training.loading.open_dataset import spread_indices
from training.pages.pictures import draw_batch
from training.run.batches import read_batches
from training.run.run_folder import BATCH, folder_errors
from training.run.stages import Stage, next_stage
from training.run.task import open_task
from training.run.training_run import RunResult, TrainingRun

# Samples of the batch that are drawn, and frames of each set that are described.
_DRAWN, _DESCRIBED = 8, 50
# Percentiles of the depth that are described.
_PERCENTILES = (1, 50, 99)


def dry_run(stages: Sequence[Stage], run: TrainingRun) -> RunResult:
    """Open all that the next stage of a run needs, and draw its first batch.

    batch.png is the only file that is written: the folder does not become a run's. Errors are those
    of `train_stages`.
    """
    stage, run = next_stage(stages, run)
    recipe = stage.recipe
    with join_processes(run.device) as processes:
        task = open_task(recipe, run, processes)
        with read_batches(task, step=0) as batches:
            batch = next(batches)
        if processes.is_first:
            with folder_errors(run.out):
                run.out.mkdir(parents=True, exist_ok=True)
            overlay = Overlay(
                list_classes(recipe.model.class_table), task.network.config.max_depth_m
            )
            atomic_write(run.out / BATCH, encode_png(draw_batch(batch, overlay, count=_DRAWN)))
        processes.wait()
    path, (height, width) = run.out / BATCH, task.data.augment.size
    lines = [f"crops of {height} x {width} px"]
    for item, source in zip(recipe.data.source, task.sources, strict=True):
        lines += _describe_set(item.title, source, recipe.model.class_names)
    return RunResult(path, lines=[*lines, str(path)])


def _describe_set(title: str, source: SampleSource, classes: Sequence[str]) -> Iterator[str]:
    """Describe a set of the mixture by some of its frames."""
    counts = np.zeros(256, dtype=np.int64)
    depths, pixels = [], 0
    for index in spread_indices(source, _DESCRIBED):
        sample = source[index]
        counts += np.bincount(sample.semantic.ravel(), minlength=256)
        depths.append(sample.depth[sample.depth > 0])
        pixels += sample.semantic.size
    yield f"{title}: {len(source)} frames"
    labelled = counts.sum() - counts[NO_CLASS]
    if labelled:
        shares = (f"{name} {counts[index] / labelled:.1%}" for index, name in enumerate(classes))
        yield f"  classes ({labelled / pixels:.0%} of the pixels): {', '.join(shares)}"
    depth = np.concatenate(depths)
    if depth.size:
        metres = zip(_PERCENTILES, np.percentile(depth, _PERCENTILES), strict=True)
        text = ", ".join(f"{share} % {value:.1f} m" for share, value in metres)
        yield f"  depth ({depth.size / pixels:.1%} of the pixels), percentiles: {text}"
