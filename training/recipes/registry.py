"""The recipes of the package, by name. A new one: its file, and a line here."""

from collections.abc import Mapping
from dataclasses import dataclass

from training.recipes import ablation, comparison, kitti_depth, lite, nano, paper
from training.stages import Stage


@dataclass(frozen=True)
class PackageRecipe:
    """What a recipe trains, in a sentence, and its stages."""

    description: str
    stages: tuple[Stage, ...]


_SINGLE = {
    **paper.RECIPES,
    **{f"comparison-{task}": item for task, item in comparison.RECIPES.items()},
    **{f"ablation-{row}": item for row, item in ablation.ROWS.items()},
}
RECIPES: Mapping[str, PackageRecipe] = {
    "lite": PackageRecipe(
        "ssdnet-lite with an encoder that begins with weights of ImageNet, in seven stages.",
        lite.STAGES,
    ),
    "nano": PackageRecipe(
        "ssdnet-nano, which also learns the answers of --teacher ssdnet-lite, in three stages.",
        nano.STAGES,
    ),
    "kitti-depth": PackageRecipe(
        "ssdnet-lite on KITTI's depth completion benchmark, with classes from rendered streets.",
        (Stage("", kitti_depth.RECIPE),),
    ),
    **{name: PackageRecipe(text, (Stage("", recipe),)) for name, (text, recipe) in _SINGLE.items()},
}
