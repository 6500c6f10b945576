"""The folder of a training, whose model can be scored on its validation sets."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from runtime.base.errors import InputError
from training.datasets.class_mapping import ClassTable
from training.datasets.source_recipe import SourceRecipe
from training.recipe import Recipe, build
from training.run_folder import BEST, DATA_FOLDERS, FINAL, RECIPE


@dataclass(frozen=True)
class EvaluatedRun:
    """The content of a run's folder.

    Attributes:
        model: its checkpoint, model.pt, or best.pt if the run is not finished.
        sets: its validation sets, with absolute paths.
        lidar: the LiDAR input of its validation.
        table: the classes of its labels.
    """

    model: Path
    sets: Sequence[SourceRecipe]
    lidar: str
    table: ClassTable


def read_run(folder: Path) -> EvaluatedRun:
    """Read a run's folder; of several stages, the recipe of the last one counts.

    Raises:
        InputError: if the folder is not that of a run, or has no model yet.
    """
    recipes = [folder / RECIPE, folder / "training" / RECIPE, *sorted(folder.glob(f"*-*/{RECIPE}"))]
    path = next((path for path in reversed(recipes) if path.is_file()), None)
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
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        recipe = build(Recipe, document["recipe"])
    except (OSError, ValueError, KeyError, InputError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give --data instead") from error
    roots = [Path(root) for root in document.get(DATA_FOLDERS, ())]
    sets = [_find(source, roots, folder) for source in recipe.validation.source]
    return EvaluatedRun(model, sets, recipe.validation.lidar, recipe.model.class_table)


def _find(source: SourceRecipe, roots: Sequence[Path], folder: Path) -> SourceRecipe:
    """Return a set with its absolute path; a missing one keeps its path for the error."""
    for root in (*roots, folder, folder.parent):
        if (root / source.path).exists():
            return replace(source, path=str(root / source.path), name=source.title)
    return source
