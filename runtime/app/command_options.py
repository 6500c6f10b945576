"""Options that several commands share."""

from typing import Annotated

import typer

import runtime


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ssdnet {runtime.__version__}")
        raise typer.Exit


# The option --version of every command.
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version."),
]
