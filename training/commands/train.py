"""`ssdnet-train`: from a recipe to a checkpoint."""

# ruff: noqa: RUF009 - what is called in classes of options returns a field

import shlex
import sys
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

import training
from runtime.command.options import with_options
from runtime.command.process import reported_errors
from training.commands.options import (
    EXIT_CODES,
    StepOptions,
    end_run,
    option,
    training_command,
)

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)

# Options of earlier releases, and the command that replaces each. Its argument is their value.
_MOVED = {"--adapt": "ssdnet-adapt", "--images": "ssdnet-finetune"}
_USAGE = 2


class _TrainCommand(TyperCommand):
    """Refuses options of earlier releases, and prints the command that replaces them."""

    # typer's own copy of click, or click: the type of a context depends on the release of typer.
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; options that moved end the command, whatever else is given."""
        for moved, command in _MOVED.items():
            for index, argument in enumerate(args):
                if argument == moved or argument.startswith(f"{moved}="):
                    value = argument.removeprefix(moved).removeprefix("=")
                    rest = [*args[:index], *([value] if value else []), *args[index + 1 :]]
                    text = f"error: {moved} is a command of its own: {command} {shlex.join(rest)}"
                    typer.echo(text, err=True)
                    sys.exit(_USAGE)
        return super().parse_args(ctx, args)


def _print_recipes(wanted: bool) -> None:
    if wanted:
        with reported_errors("train"):
            from training.recipes.registry import RECIPES

        for name, recipe in RECIPES.items():
            typer.echo(f"{name:28} {recipe.description}")
        raise typer.Exit


@dataclass(frozen=True, kw_only=True)
class _Recipe:
    """Options that name the recipe and its data."""

    recipe: str = option(
        "Name of a recipe, see --list, or a path that ends in .toml or holds a slash; the "
        "recipe.json of a run trains again what was trained.",
        default=MISSING,
        kind=typer.Argument,
    )
    data: list[Path] = option(
        "Folder with the recipe's data sets. May be repeated.", default=MISSING, metavar="DIR"
    )


@dataclass(frozen=True, kw_only=True)
class _Options(StepOptions, _Recipe):  # the options of the last class come first
    init: str | None = option(
        "Initial weights: the name of installed weights (ssdnet-lite), or a path that ends in .pt "
        "or holds a slash. What a TOML file leaves out comes from their training."
    )
    teacher: str | None = option(
        "Weights whose answers are learned beside the labels: a name or path as in --init."
    )


@app.command(cls=_TrainCommand, epilog=EXIT_CODES)
@with_options(_Options)
def train(
    *,
    _list: Annotated[
        bool,
        typer.Option("--list", callback=_print_recipes, is_eager=True, help="List the recipes."),
    ] = False,
    **given: Any,
) -> None:
    """Train a network by a recipe.

    Writes checkpoints, TensorBoard curves, scores and the resolved recipe. See ssdnet-finetune for
    folders of your own images and labels, and ssdnet-adapt for a recording without labels.
    """
    with training_command(given) as options:
        end_run(training.train(**options), options["stop"])
