"""`ssdnet-export`: a checkpoint in, one verified ONNX file out."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.contract import MIN_SIDE

ERROR = 1  # exit code


def main() -> None:
    """Entry point of the command."""
    app()


app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 done; 1 error, nothing was written; 2 usage.")
def export(
    checkpoint: Annotated[Path, typer.Argument(help="Checkpoint written by ssdnet-train.")],
    model: Annotated[Path, typer.Argument(help="ONNX file to write.")],
    height: Annotated[int | None, typer.Option(min=MIN_SIDE, help="Rows. [default: 512]")] = None,
    width: Annotated[
        int | None, typer.Option(min=MIN_SIDE, help="Columns. [default: 1024]")
    ] = None,
    dynamic: Annotated[
        bool, typer.Option("--dynamic", help="Accept any size, not only that one.")
    ] = False,
    opset: Annotated[int, typer.Option(min=18, help="ONNX operator set.")] = 18,
    with_logits: Annotated[
        bool, typer.Option("--with-logits", help="Add the class scores to the outputs.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an older file.")] = False,
) -> None:
    """Export a checkpoint to one self-contained ONNX file and verify it against PyTorch."""
    if (height is None) != (width is None):
        raise typer.BadParameter("give both --height and --width, or neither")
    size = None if height is None or width is None else (height, width)
    try:  # here, so that --help does not wait for PyTorch
        from export.exporter import export_checkpoint
        from runtime.errors import SSDNetError
    except ImportError as error:
        typer.echo(f'error: {error}: pip install "ssdnet[export,cpu]"', err=True)
        raise typer.Exit(ERROR) from error
    try:
        report = export_checkpoint(
            checkpoint,
            model,
            size=size,
            dynamic=dynamic,
            opset=opset,
            with_logits=with_logits,
            overwrite=overwrite,
        )
    except SSDNetError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(ERROR) from error
    shape = f"{report.size[0]} x {report.size[1]}" + (", any size accepted" if dynamic else "")
    typer.echo(f"{report.path}: {report.num_bytes / 1e6:.1f} MB, {shape}, opset {opset}")
    typer.echo(f"largest difference to PyTorch on {report.num_frames} frames:")
    for head, measured in report.parity.items():
        figures = ", ".join(f"{name} {value:.6g}" for name, value in measured.figures.items())
        typer.echo(f"  {head:16}{figures}")


if __name__ == "__main__":
    main()
