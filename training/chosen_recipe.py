"""The recipe that a command names: one of the package, or a TOML file."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from runtime.errors import InputError
from runtime.read_input import read_toml
from training.fine_tuning import fine_tune
from training.initial_weights import Weights
from training.recipe import build_recipe
from training.recipes.registry import RECIPES
from training.stages import Stage


def read_stages(
    text: str, changes: Sequence[str] = (), init: Weights | None = None
) -> tuple[Stage, ...]:
    """Return the stages of a recipe; a TOML file has a single one.

    Args:
        text: a path if it ends in .toml or holds a slash, else the name of a recipe.
        changes: of every stage, see `build_recipe`.
        init: a checkpoint that the first stage starts from. What a TOML file leaves out comes from
            its training, see `training.fine_tuning`, and is reported on stderr.

    Raises:
        InputError: for an unknown name, and as in `build_recipe`.
    """
    if text.endswith(".toml") or "/" in text or "\\" in text:
        table = read_toml(Path(text))
        return (Stage("", build_recipe(table, text, changes, partial(fine_tune, init=init))),)
    if text not in RECIPES:
        raise InputError(
            f"unknown recipe {text!r}; known: {', '.join(RECIPES)}. For a recipe of your own give "
            "a path that ends in .toml or holds a slash."
        )
    return tuple(
        replace(stage, recipe=build_recipe(asdict(stage.recipe), text, changes))
        for stage in RECIPES[text].stages
    )
