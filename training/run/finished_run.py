"""The folder of a training, whose model can be scored on its validation sets."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from models.checkpoint import BEST, FINAL, RECIPE
from runtime.base.errors import DatasetError, InputError
from training.base.tables import build
from training.datasets.sample import SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.loading.open_dataset import open_dataset
from training.run.recipe import Recipe
from training.run.run_folder import DATA_FOLDERS, read_document


@dataclass(frozen=True)
class EvaluatedRun:
    """The content of a run's folder.

    Attributes:
        model: its checkpoint, model.pt, or best.pt if the run is not finished.
        sets: its validation sets, with absolute paths.
        recipe: its recipe.
    """

    model: Path
    sets: Sequence[SourceRecipe]
    recipe: Recipe


def read_run(folder: Path) -> EvaluatedRun:
    """Read a run's folder; of several stages, the recipe of the last one counts.

    Raises:
        InputError: if the folder is not that of a run, or has no model yet.
    """
    path = _recipe_path(folder)
    if path is None:
        raise InputError(
            f"{folder}: is a folder, but not of a run of ssdnet-train (no {RECIPE}): name the file "
            "of a model, or score answers with --predictions"
        )
    places = [folder / FINAL, folder / BEST, path.parent / BEST]
    model = next((place for place in places if place.is_file()), None)
    if model is None:
        raise InputError(
            f"{folder}: has no {FINAL} and no {BEST}: resume the training, which writes them"
        )
    recipe, sets = _read(path, folder, "validation")
    return EvaluatedRun(model, sets, recipe)


def open_training_sets(folder: Path) -> list[SampleSource]:
    """Open the sets that a run was trained on; none for another folder, or where they are gone."""
    path = _recipe_path(folder)
    if path is None:
        return []
    with contextlib.suppress(InputError, DatasetError):
        recipe, sets = _read(path, folder, "data")
        return [open_dataset(item, [Path()], classes=recipe.model.class_table) for item in sets]
    return []


def _recipe_path(folder: Path) -> Path | None:
    recipes = [folder / RECIPE, folder / "training" / RECIPE, *sorted(folder.glob(f"*-*/{RECIPE}"))]
    return next((path for path in reversed(recipes) if path.is_file()), None)


def _read(path: Path, folder: Path, table: str) -> tuple[Recipe, list[SourceRecipe]]:
    """Return the recipe of a run in `folder`, and the sets of a table of it with absolute paths."""
    document = read_document(path)
    try:
        recipe = build(Recipe, document["recipe"])
    except InputError as error:
        raise InputError(f"{path}: cannot be read ({error}): give --data instead") from error
    roots = [*map(Path, document.get(DATA_FOLDERS, ())), folder, folder.parent]
    sets: list[SourceRecipe] = []
    for source in getattr(recipe, table).source:
        found = next((root / source.path for root in roots if (root / source.path).exists()), None)
        changes = {} if found is None else {"path": str(found), "name": source.title}
        sets.append(replace(source, **changes))  # a missing one keeps its path for the error
    return recipe, sets
