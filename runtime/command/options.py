"""Options that several commands share."""

from enum import StrEnum
from typing import Annotated

import typer

import runtime


class Provider(StrEnum):
    """Choices of --provider."""

    cpu = "cpu"
    cuda = "cuda"


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ssdnet {runtime.__version__}")
        raise typer.Exit


# The option --threads of the commands that run one model.
Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
]
# The option --version of every command.
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version."),
]
