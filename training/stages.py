"""Recipes of several stages: each is a run that starts from the weights of the stage before."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from models import Network, load_checkpoint, save_checkpoint
from runtime.base.errors import InputError
from runtime.files.atomic_write import atomic_write
from training.distributed import join_processes
from training.initial_weights import Weights, read_weights
from training.loading.open_dataset import open_dataset, spread_pictures
from training.loop import train
from training.recipe import Recipe
from training.run_folder import FINAL, RECIPE, folder_errors

# The file in a stage's folder with the result of its call on the trained weights.
RESULT = "result.pt"


@dataclass(frozen=True)
class Trained:
    """The argument of a stage's call.

    Attributes:
        before: the network that it began with; None: random weights.
        after: the trained network.
        pictures: images of its data, each float (1, 3, H, W), RGB in 0..255.
    """

    before: Network | None
    after: Network
    pictures: Iterable[Tensor]


@dataclass(frozen=True)
class Stage:
    """A run of a recipe, and what is made of its weights.

    Attributes:
        folder: NUMBER-NAME, below the folder of the run; "" for that folder itself, if the recipe
            has one stage only.
        recipe: the recipe of this stage.
        then: returns the network that the next stage begins with; that of the last stage is written
            to RUN/model.pt. None: the trained network is taken as it is.
    """

    folder: str
    recipe: Recipe
    then: Callable[[Trained], Network] | None = None

    @property
    def result(self) -> str:
        """The file in its folder with the weights that the next stage begins with."""
        return FINAL if self.then is None else RESULT


def train_stages(
    stages: Sequence[Stage],
    *,
    data: Sequence[Path],
    out: Path,
    init: Weights | None = None,
    teacher: Weights | None = None,
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Path:
    """Run all stages; a run that was stopped or killed is resumed in its stage.

    Each stage is a run in `out`/NUMBER-NAME that begins with the result of the stage before: its
    model.pt or, if the stage has a call, the result.pt that the call makes of it. The result of the
    last stage is also `out`/model.pt. A finished stage is not run again; it is an error if its
    recipe has changed.

    Args:
        stages: the stages of a recipe, in order.
        data: see `train`, like what follows.
        out: folder of all stages.
        init: a checkpoint that the first stage starts from.
        teacher: a checkpoint whose answers all stages learn.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step, counted over all stages.
        stop: called between two steps; True stops.

    Returns:
        `out`/model.pt, or the last.pt of the stage that was stopped; stopped exactly between two
        stages, the model.pt of the first of them.

    Raises:
        InputError: if `out` belongs to other stages, and as in `train`, like all others.
    """
    _require_same_stages(stages, out)
    with join_processes(device) as processes:
        for stage in stages:
            folder = out / stage.folder
            path = train(
                stage.recipe,
                data=data,
                out=folder,
                init=init,
                teacher=teacher,
                device=device,
                stop_after=stop_after,
                stop=stop,
            )
            if path.name != FINAL:
                return path
            if processes.is_first:
                _make_result(stage, folder, folder, init, data)
            processes.wait()  # until the file is written
            result = folder / stage.result
            if stage is stages[-1]:
                break
            init = read_weights(result)
            if stop_after is not None:
                stop_after -= stage.recipe.schedule.steps
                if stop_after < 1:
                    return path
        if result != out / FINAL and processes.is_first:
            with folder_errors(out):
                atomic_write(out / FINAL, result.read_bytes())
        processes.wait()  # until the file is written
    return out / FINAL


def _make_result(
    stage: Stage, folder: Path, made: Path, init: Weights | None, data: Sequence[Path]
) -> None:
    """Run `then` of a finished stage, and write its network to `made`, unless it exists."""
    if stage.then is not None and not (made / stage.result).is_file():
        before = None if init is None else init.network
        trained = load_checkpoint(folder / FINAL)
        network = stage.then(Trained(before, trained.model, _read_pictures(stage.recipe, data)))
        save_checkpoint(made / stage.result, network, training=trained.training)


def _read_pictures(recipe: Recipe, data: Sequence[Path]) -> Iterator[Tensor]:
    """Yield pictures of a recipe's data; nothing is opened before the first is asked for."""
    classes = recipe.model.class_table
    yield from spread_pictures(
        [open_dataset(item, data, classes=classes) for item in recipe.data.source]
    )


def next_stage(
    stages: Sequence[Stage], out: Path, init: Weights | None, data: Sequence[Path]
) -> tuple[Stage, Path, Weights | None]:
    """Return the first stage that is not finished, its folder, and the weights it starts from.

    Nothing is written to `out`.
    """
    _require_same_stages(stages, out)
    for stage in stages:
        folder = out / stage.folder
        if not (folder / FINAL).is_file() or stage is stages[-1]:
            break
        if (folder / stage.result).is_file():
            init = read_weights(folder / stage.result)
            continue
        with tempfile.TemporaryDirectory() as made:
            _make_result(stage, folder, Path(made), init, data)
            init = read_weights(Path(made) / stage.result)
    return stage, folder, init


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
