"""Validations during a training, and its curves and pictures in TensorBoard."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from models import Network
from training.base.stop_signal import Stop, StopRequested
from training.lidar.split import LidarInput
from training.loading.open_dataset import Watched
from training.pages.page import Curves, write_page
from training.pages.pictures import draw_pictures
from training.pages.worst_frames import draw_worst
from training.run.run_folder import folder_errors
from training.run.score_table import SHOWN
from training.run.state import Step
from training.run.task import Task
from training.scores.differences import compare
from training.scores.evaluated_set import EvaluatedSet, Feed
from training.scores.score_set import Result, score_set
from training.scores.scored_model import open_network
from training.scores.scoring import OTHER, scored_classes
from training.scores.shared_classes import ScoredClasses


class Board:
    """TensorBoard's file of a run in `folder`; none in processes that do not write.

    A context manager that ends the file. InputError if it cannot be written.
    """

    def __init__(self, folder: Path | None, step: int) -> None:
        self._folder, self._writer = folder, None
        if folder is not None:
            with folder_errors(folder):
                # Entries of later steps, of an interrupted run, are hidden.
                purge = step + 1 if step else None
                self._writer = SummaryWriter(folder, purge_step=purge, flush_secs=10)

    def __enter__(self) -> "Board":
        """Return the board."""
        return self

    def __exit__(self, *_: object) -> None:
        """Write the entries that are still buffered."""
        self._write("close")

    def add_step(self, done: Step, log_variances: Mapping[str, Tensor], step: int) -> None:
        """Add the terms of a step, the weights that the loss learned, and the rate."""
        terms = {f"loss/{name}": term.item() for name, term in done.terms.items()}
        learned = {f"log_variance/{name}": value.item() for name, value in log_variances.items()}
        self.add_scalars({**terms, **learned, "learning_rate": done.rate}, step)

    def add_scalars(self, values: Mapping[str, float], step: int) -> None:
        """Add a point to each curve."""
        for name, value in values.items():
            self._write("add_scalar", name, value, step)

    def add_picture(self, name: str, rgb: np.ndarray, step: int) -> None:
        """Add a picture, uint8 (H, W, 3)."""
        self._write("add_image", name, rgb, step, dataformats="HWC")

    def _write(self, call: str, *arguments: Any, **options: Any) -> None:
        if self._folder is not None:
            with folder_errors(self._folder):  # of the writer's thread, at the call that follows
                getattr(self._writer, call)(*arguments, **options)


def write_validation(
    networks: Mapping[str, Network],
    task: Task,
    path: Path,
    *,
    known: Mapping[str, Sequence[Result]],
    curves: Curves,
) -> None:
    """Write the page of networks on the validation sets, see `training.pages.page`.

    Args:
        networks: name -> network, of the recipe's classes; others are compared with the first.
        task: the task that holds the sets.
        path: path of the page.
        known: results of `validate` by name of the network; networks without are scored.
        curves: see `write_page`.

    Once the run is stopped, it ends without a page.
    """
    sets, table = _open_sets(task, task.run.stop), task.recipe.model.class_table
    models = {name: open_network(network, table) for name, network in networks.items()}
    with suppress(StopRequested):
        results = [
            result
            for data in sets
            for name, model in models.items()
            for result in known.get(name) or score_set(name, model, data, [_feed(task)])
            if result.row.data == data.title
        ]
        worst = list(draw_worst(results, models, sets))
        title = f"Validation of {path.absolute().parent.name}"
        differences = compare(results)
        write_page(results, path, differences=differences, worst=worst, title=title, curves=curves)
        tqdm.write(f"the page of the validation: {path}", file=sys.stderr)


def _open_sets(task: Task, stop: Stop) -> list[EvaluatedSet]:
    recipe = task.recipe
    classes = ScoredClasses(recipe.model.class_table, tuple(recipe.model.class_names))
    farthest_m = recipe.validation.farthest_m
    return [
        EvaluatedSet(name, Watched(source, stop), classes, range(len(source)), farthest_m)
        for name, source in task.validation.items()
    ]


def _feed(task: Task) -> Feed:
    return LidarInput.parse(task.recipe.validation.lidar), "none"


def validate(name: str, network: Network, task: Task, board: Board, step: int) -> list[Result]:
    """Score the network, each process on its share of the frames; show scores and pictures.

    Raises StopRequested once the run is stopped; several processes wait for one another, so that
    none of them leaves early.

    Returns:
        The result of each set, named `name`.
    """
    sets = _open_sets(task, task.stop)
    model = open_network(network, task.recipe.model.class_table)
    results = [
        result
        for data in sets
        for result in score_set(name, model, data, [_feed(task)], processes=task.processes)
    ]
    scores = {result.row.data: result.row.figures for result in results}
    shown = {
        f"{name}/{key}": figures[key]
        for name, figures in scores.items()
        for key in (*SHOWN, *(each for each in figures if each.startswith(OTHER)))
        if key in figures
    }
    board.add_scalars({f"validation/{name}": score for name, score in shown.items()}, step)
    if not task.processes.is_first:
        return results
    words = {f"{name}/miou": scored_classes(figures) for name, figures in scores.items()}
    text = ", ".join(f"{key} {score:.4f}{words.get(key, '')}" for key, score in shown.items())
    tqdm.write(f"step {step}: {text}", file=sys.stderr)
    for data in sets:
        (lidar, _), count = _feed(task), task.recipe.validation.pictures
        drawn = draw_pictures(model.predict, data.source, network, lidar=lidar, count=count)
        for frame, picture in drawn:
            board.add_picture(f"{data.title}/{frame}", picture, step)
    return results
