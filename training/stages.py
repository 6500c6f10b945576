"""Recipes of several stages: runs one after the other, each from the weights of the one before."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from runtime.errors import InputError
from runtime.io.atomic_write import atomic_write
from training.distributed import join_processes
from training.loop import train
from training.recipe import Recipe
from training.run_folder import FINAL, RECIPE, folder_errors


@dataclass(frozen=True)
class Stage:
    """A run: its folder below --out, NUMBER-NAME ("" = --out itself, of a recipe of one run)."""

    folder: str
    recipe: Recipe


def train_stages(
    stages: Sequence[Stage],
    *,
    data: Sequence[Path],
    out: Path,
    init: Path | None = None,
    teacher: Path | None = None,
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Path:
    """Run all stages; a run that was stopped or killed is resumed in its stage.

    Each is a run of its own in ``out``/NUMBER-NAME that begins with the model.pt of the one before;
    that of the last is also ``out``/model.pt. A finished stage is not run again, but refused where
    its recipe is another one now.

    Args:
        stages: of a recipe, in order.
        data: see `train`, like what follows.
        out: folder of all stages.
        init: a checkpoint that the first stage starts from.
        teacher: a checkpoint whose answers all stages learn.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step, counted over all stages.
        stop: called between two steps; True stops.

    Returns:
        ``out``/model.pt, or the last.pt of the stage that was stopped; stopped exactly between two
        stages, the model.pt of the first of them.

    Raises:
        InputError: if ``out`` belongs to other stages, and as in `train`, like all others.
    """
    _require_same_stages(stages, out)
    path = out
    with join_processes(device) as processes:
        for stage in stages:
            path = train(
                stage.recipe,
                data=data,
                out=out / stage.folder,
                init=init,
                teacher=teacher,
                device=device,
                stop_after=stop_after,
                stop=stop,
            )
            if path.name != FINAL:
                return path
            init = path
            if stop_after is not None:
                stop_after -= stage.recipe.schedule.steps
                if stop_after < 1 and stage is not stages[-1]:
                    return path
        if path.parent != out and processes.is_first:
            with folder_errors(out):
                atomic_write(out / FINAL, path.read_bytes())
        processes.wait()  # until the file is written
    return out / FINAL


def next_stage(
    stages: Sequence[Stage], out: Path, init: Path | None
) -> tuple[Stage, Path, Path | None]:
    """Return the first stage that is not finished, its folder, and the weights it starts from."""
    _require_same_stages(stages, out)
    for stage in stages:
        final = out / stage.folder / FINAL
        if not final.is_file() or stage is stages[-1]:
            break
        init = final
    return stage, out / stage.folder, init


def _require_same_stages(stages: Sequence[Stage], out: Path) -> None:
    """Raise InputError for a folder with runs of other stages."""
    wanted = {stage.folder for stage in stages}
    found = {path.parent.name for path in out.glob(f"[0-9]*-*/{RECIPE}")}
    if "" not in wanted and (out / RECIPE).is_file():
        found.add("a run without stages")
    if others := sorted(found - wanted):
        raise InputError(
            f"{out}: holds {others[0]}, but the stages of this recipe are "
            f"{', '.join(sorted(wanted)) or 'none'}. Choose another --out."
        )
