"""Options that several commands have."""

from collections.abc import Callable
from typing import Annotated

import typer

import runtime


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ssdnet {runtime.__version__}")
        raise typer.Exit


def _refuse(hint: str) -> Callable[[str | None], None]:
    def refuse(value: str | None) -> None:
        if value is not None:
            raise typer.BadParameter(hint)

    return refuse


#: Every command's --version.
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version."),
]

#: Of commands that have --provider: the word of those that run PyTorch.
NoDevice = Annotated[
    str | None,
    typer.Option(
        "--device",
        hidden=True,
        is_eager=True,
        callback=_refuse("this command runs ONNX Runtime: use --provider cpu or --provider cuda"),
    ),
]

#: Of commands that have --device: the word of those that run ONNX Runtime.
NoProvider = Annotated[
    str | None,
    typer.Option(
        "--provider",
        hidden=True,
        is_eager=True,
        callback=_refuse("this command runs PyTorch: use --device cpu, cuda or cuda:N"),
    ),
]
