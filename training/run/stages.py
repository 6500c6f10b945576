"""Recipes of several stages: each is a run that starts from the weights of the stage before."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from models import Network, load_checkpoint, save_checkpoint
from models.checkpoint import FINAL, RECIPE
from runtime.base.errors import InputError
from runtime.files.atomic_write import atomic_write
from training.base.processes import join_processes
from training.loading.open_dataset import open_dataset, spread_pictures
from training.run.loop import train
from training.run.recipe import Recipe
from training.run.run_folder import folder_errors
from training.run.training_run import RunResult, TrainingRun
from training.weights.initial_weights import read_weights

# The file in a stage's folder with the result of its call on the trained weights.
RESULT = "result.pt"


@dataclass(frozen=True)
class Stage:
    """A run of a recipe, and what is made of its weights.

    Attributes:
        folder: NUMBER-NAME, below the folder of the run; "" for that folder itself, if the recipe
            has one stage only.
        recipe: the recipe of this stage.
        then: returns the network that the next stage begins with, of the trained one and of images
            of its data, each float (1, 3, H, W), RGB in 0..255; that of the last stage is written
            to RUN/model.pt. None: the trained network is taken as it is.
    """

    folder: str
    recipe: Recipe
    then: Callable[[Network, Iterable[Tensor]], Network] | None = None

    @property
    def result(self) -> str:
        """The file in its folder with the weights that the next stage begins with."""
        return FINAL if self.then is None else RESULT


def train_stages(stages: Sequence[Stage], run: TrainingRun) -> RunResult:
    """Run all stages; a run that was stopped or killed is resumed in its stage.

    Each stage is a run in `run.out`/NUMBER-NAME that begins with the result of the stage before:
    its model.pt or, if the stage has a call, the result.pt that the call makes of it. The result of
    the last stage is also `run.out`/model.pt. A finished stage is not run again; it is an error if
    its recipe has changed.

    Args:
        stages: the stages of a recipe, in order.
        run: see `train`; its `init` is that of the first stage.

    Returns:
        The model.pt in `run.out`, or the last.pt of the stage that was stopped; stopped exactly
        between two stages, the model.pt of the first of them.

    Raises:
        InputError: if the folder belongs to other stages, and as in `train`, like all others.
    """
    _require_same_stages(stages, run.out)
    out, left = run.out, run.stop_after
    with join_processes(run.device) as processes:
        for stage in stages:
            run = replace(run, out=out / stage.folder, stop_after=left)
            found = train(stage.recipe, run)
            if found.stopped:
                return found
            if processes.is_first:
                _make_result(stage, run, run.out)
            processes.wait()  # until the file is written
            result = run.out / stage.result
            if stage is stages[-1]:
                break
            run = replace(run, init=read_weights(result))
            if left is not None:
                left -= stage.recipe.schedule.steps
                if left < 1:
                    return replace(found, stopped=True)
        if result != out / FINAL and processes.is_first:
            with folder_errors(out):
                atomic_write(out / FINAL, result.read_bytes())
        processes.wait()  # until the file is written
    return RunResult(out / FINAL)


def _make_result(stage: Stage, run: TrainingRun, made: Path) -> None:
    """Run `then` of a finished stage, and write its network to `made`, unless it exists."""
    if stage.then is not None and not (made / stage.result).is_file():
        trained = load_checkpoint(run.out / FINAL)
        network = stage.then(trained.model, _read_pictures(stage.recipe, run.data))
        save_checkpoint(made / stage.result, network, training=trained.training)


def _read_pictures(recipe: Recipe, data: Sequence[Path]) -> Iterator[Tensor]:
    """Yield pictures of a recipe's data; nothing is opened before the first is asked for."""
    classes = recipe.model.class_table
    yield from spread_pictures(
        [open_dataset(item, data, classes=classes) for item in recipe.data.source]
    )


def next_stage(stages: Sequence[Stage], run: TrainingRun) -> tuple[Stage, TrainingRun]:
    """Return the first stage that is not finished, and its run: its folder and initial weights.

    Nothing is written to the folder.
    """
    _require_same_stages(stages, run.out)
    out = run.out
    for stage in stages:
        run = replace(run, out=out / stage.folder)
        if not (run.out / FINAL).is_file() or stage is stages[-1]:
            break
        with tempfile.TemporaryDirectory() as made:
            place = run.out if (run.out / stage.result).is_file() else Path(made)
            _make_result(stage, run, place)
            run = replace(run, init=read_weights(place / stage.result))
    return stage, run


def _require_same_stages(stages: Sequence[Stage], out: Path) -> None:
    """Raise InputError for a folder with runs of other stages."""
    wanted = {stage.folder for stage in stages}
    found = {path.parent.name for path in out.glob(f"[0-9]*-*/{RECIPE}")}
    if "" not in wanted and (out / RECIPE).is_file():
        found.add("a run without stages")
    if others := sorted(found - wanted):
        raise InputError(
            f"{out}: holds {others[0]}, but the stages of this recipe are "
            f"{', '.join(sorted(wanted)) or 'none'}: choose another --out"
        )
