"""Recipes of several stages: runs one after the other, each from the weights of the one before."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.checks import shown
from runtime.errors import InputError
from runtime.io.atomic_write import atomic_write
from training.distributed import join_processes
from training.fine_tuning import EarlierTraining
from training.loop import train
from training.recipe import Recipe, build, merge, parse_changes, read_table
from training.run_folder import FINAL, RECIPE, folder_errors

_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True)
class Stage:
    """A run of a recipe: its folder below --out ("" = --out itself) and its recipe."""

    folder: str
    recipe: Recipe


def read_stages(
    path: Path, changes: Sequence[str] = (), init: Path | None = None
) -> tuple[Stage, ...]:
    """Read a recipe with its stages from a TOML file; arguments and errors as in `build_stages`."""
    return build_stages(read_table(path), path, changes, init)


def build_stages(
    table: Mapping[str, Any], path: Path, changes: Sequence[str] = (), init: Path | None = None
) -> tuple[Stage, ...]:
    """Return the stages of a recipe; one without ``[[stage]]`` has a single stage.

    Each ``[[stage]]`` has a name and keys that it changes of the recipe; ``base`` in it names an
    earlier stage whose changes come first.

    Args:
        table: the recipe.
        path: its file, for messages.
        changes: further changes of all stages, see `read_recipe`.
        init: a checkpoint that the first stage starts from. What the recipe leaves out comes from
            its training, see `training.fine_tuning`, and is reported on stderr.

    Raises:
        InputError: see `read_recipe`, and for stages without a name of their own or whose base is
            not an earlier stage.
        CheckpointError: if ``init`` cannot be read.
    """
    table, further = {**table}, parse_changes(changes)
    tables = table.pop("stage", None)
    try:
        named = {} if tables is None else _name_stages(tables)
        changed = [merge(merge(table, stage), further) for stage in named.values()]
        whole = changed or [merge(table, further)]
        if init is not None:
            earlier = EarlierTraining(init)
            earlier.report(whole[0])
            whole = [earlier.complete(item) for item in whole]
        folders = [f"{number}-{name}" for number, name in enumerate(named, start=1)] or [""]
        return tuple(
            Stage(folder, build(Recipe, item)) for folder, item in zip(folders, whole, strict=True)
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _name_stages(tables: object) -> dict[str, dict[str, Any]]:
    """Return what each stage changes, by its name; the changes of its base come first."""
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise InputError("stage: expected tables [[stage]].")
    stages: dict[str, dict[str, Any]] = {}
    for index, table in enumerate(tables):
        changed = {**table}
        name, base = changed.pop("name", None), changed.pop("base", None)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InputError(
                f"stage[{index}].name = {shown(name)}; expected small letters, digits and hyphens."
            )
        if name in stages:
            raise InputError(f"stage[{index}].name = {name!r}: another stage has this name.")
        if base is not None and (not isinstance(base, str) or base not in stages):
            raise InputError(
                f"stage[{index}].base = {shown(base)}; expected the name of an earlier stage: "
                f"{', '.join(stages) or 'there is none'}."
            )
        stages[name] = merge(stages[base], changed) if base is not None else changed
    return stages


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
        stages: see `read_stages`.
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
