"""The recipes of the package, by name. A new one: its file, and a line here."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType

from training.recipes import ablation, comparison, kitti_depth, lite, nano, open, paper
from training.run.stages import Stage


@dataclass(frozen=True)
class PackageRecipe:
    """What a recipe trains, in a sentence, and its stages."""

    description: str
    stages: tuple[Stage, ...]


def _described(recipe: ModuleType, stages: tuple[Stage, ...]) -> PackageRecipe:
    """Describe a recipe by the first line of its file."""
    return PackageRecipe(str(recipe.__doc__).splitlines()[0], stages)


_SINGLE = {
    **paper.RECIPES,
    **{f"comparison-{task}": item for task, item in comparison.RECIPES.items()},
    **{f"ablation-{row}": item for row, item in sorted(ablation.ROWS.items())},
}
RECIPES: Mapping[str, PackageRecipe] = {
    "lite": _described(lite, lite.STAGES),
    "nano": _described(nano, nano.STAGES),
    "open": _described(open, open.STAGES),
    "lite-classes": PackageRecipe(
        "The classes and boundaries of lite, by a --teacher.", (Stage("", lite.CLASSES),)
    ),
    "lite-depth": PackageRecipe("The last stage of lite: its depth.", (Stage("", lite.DEPTH),)),
    "open-depth": PackageRecipe("The last stage of open: its depth.", (Stage("", open.DEPTH),)),
    "nano-depth": PackageRecipe("The last stage of nano: its depth.", (Stage("", nano.DEPTH),)),
    "kitti-depth": _described(kitti_depth, (Stage("", kitti_depth.RECIPE),)),
    **{name: PackageRecipe(text, (Stage("", recipe),)) for name, (text, recipe) in _SINGLE.items()},
}
