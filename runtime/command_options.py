"""Options that several commands have."""

from typing import Annotated, Any

import typer

import runtime


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ssdnet {runtime.__version__}")
        raise typer.Exit


def _other_word(option: str, hint: str) -> Any:
    """A hidden option that raises an error which names the right option."""

    def refuse(value: str | None) -> None:
        if value is not None:
            raise typer.BadParameter(hint)

    return typer.Option(option, hidden=True, is_eager=True, callback=refuse)


#: Every command's --version.
Version = Annotated[
    bool,
    typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version."),
]

#: --device is an option of the PyTorch commands; here it is an error that names --provider.
NoDevice = Annotated[
    str | None,
    _other_word(
        "--device", "this command runs ONNX Runtime: use --provider cpu or --provider cuda"
    ),
]

#: --provider is an option of the ONNX Runtime commands; here it is an error that names --device.
NoProvider = Annotated[
    str | None,
    _other_word("--provider", "this command runs PyTorch: use --device cpu, cuda or cuda:N"),
]
