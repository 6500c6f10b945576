"""Validations during a training, and its curves and pictures in TensorBoard."""

import os
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from torch import Tensor
from torch.utils.tensorboard.summary import image, scalar
from tqdm import tqdm

from models import Network
from training.datasets.sample import SampleSource
from training.distributed import Processes
from training.evaluation.pictures import draw_pictures
from training.evaluation.scoring import score_sources, scored_classes, torch_predict
from training.lidar.split import LidarInput
from training.recipe import ValidationRecipe
from training.run_folder import folder_errors
from training.score_table import SHOWN
from training.state import Step


class Board:
    """A file of TensorBoard's in ``folder``, or nothing in processes that do not write.

    PyTorch's `SummaryWriter` writes in a thread, whose errors come late and as tracebacks. Here
    InputError says at once that the file cannot be written.
    """

    def __init__(self, folder: Path | None, step: int) -> None:
        self._path: Path | None = None
        if folder is None:
            return
        name = f"events.out.tfevents.{time.time():.6f}.{socket.gethostname()}.{os.getpid()}"
        self._path = folder / name
        with folder_errors(folder):
            folder.mkdir(exist_ok=True)
        events = [Event(file_version="brain.Event:2")]
        if step:  # entries of later steps, of an interrupted run, are hidden
            events.append(Event(session_log=SessionLog(status=SessionLog.START)))
        self._write(events, step + 1)

    def add_step(self, done: Step, log_variances: Mapping[str, Tensor], step: int) -> None:
        """Add the terms of a step, the weights that the loss learned, and the rate."""
        terms = {f"loss/{name}": term.item() for name, term in done.terms.items()}
        learned = {f"log_variance/{name}": value.item() for name, value in log_variances.items()}
        self.add_scalars({**terms, **learned, "learning_rate": done.rate}, step)

    def add_scalars(self, values: Mapping[str, float], step: int) -> None:
        """Add a point to each curve."""
        self._add([scalar(*item) for item in values.items()], step)  # type: ignore[no-untyped-call]

    def add_picture(self, name: str, rgb: np.ndarray, step: int) -> None:
        """Add a picture, uint8 (H, W, 3)."""
        self._add([image(name, rgb, dataformats="HWC")], step)  # type: ignore[no-untyped-call]

    def _add(self, summaries: Sequence[Summary], step: int) -> None:
        self._write([Event(summary=summary) for summary in summaries], step)

    def _write(self, events: Sequence[Event], step: int) -> None:
        if self._path is None:
            return
        with folder_errors(self._path), self._path.open("ab") as file:
            writer = RecordWriter(file)
            for event in events:
                event.step, event.wall_time = step, time.time()
                writer.write(event.SerializeToString())


def validate(
    network: Network,
    sources: Mapping[str, SampleSource],
    recipe: ValidationRecipe,
    processes: Processes,
    board: Board,
    step: int,
) -> dict[str, dict[str, float]]:
    """Score the network, each process on its share of the frames; show scores and pictures."""
    lidar = LidarInput.parse(recipe.lidar)
    scores = score_sources(network, sources, processes, lidar=lidar)
    shown = {
        f"{name}/{key}": figures[key]
        for name, figures in scores.items()
        for key in SHOWN
        if key in figures
    }
    board.add_scalars({f"validation/{name}": score for name, score in shown.items()}, step)
    if not processes.is_first:
        return scores
    words = {f"{name}/miou": scored_classes(figures) for name, figures in scores.items()}
    text = ", ".join(f"{key} {score:.4f}{words.get(key, '')}" for key, score in shown.items())
    tqdm.write(f"step {step}: {text}", file=sys.stderr)
    predict = torch_predict(network)
    for name, source in sources.items():
        pictures = draw_pictures(predict, source, network, lidar=lidar, count=recipe.pictures)
        for frame, picture in pictures:
            board.add_picture(f"{name}/{frame}", picture, step)
    return scores
