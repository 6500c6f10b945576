"""`ssdnet-export`: a checkpoint in, one verified ONNX file out."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.command import interruptible, reported_errors
from runtime.command_options import Version
from runtime.contract import MIN_SIDE

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 done; 1 error, nothing was written; 2 usage.")
def export(
    checkpoint: Annotated[Path, typer.Argument(help="Checkpoint written by ssdnet-train.")],
    model: Annotated[Path, typer.Argument(help="ONNX file to write.")],
    height: Annotated[
        int | None,
        typer.Option(
            min=MIN_SIDE,
            help="Rows, with --width: accept this size only. All shapes in the graph are then "
            "constants, which some compilers and accelerators need. [default: any]",
        ),
    ] = None,
    width: Annotated[int | None, typer.Option(min=MIN_SIDE, help="Columns. [default: any]")] = None,
    dynamic: Annotated[
        bool,
        typer.Option(
            "--dynamic", help="Accept any size, also with --height and --width (verified there)."
        ),
    ] = False,
    opset: Annotated[int, typer.Option(min=18, help="ONNX operator set.")] = 18,
    with_logits: Annotated[
        bool, typer.Option("--with-logits", help="Add the class scores to the outputs.")
    ] = False,
    record_dir: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="DIR",
            help="Folder for a recording of PyTorch's answers: ssdnet-verify then repeats the "
            "comparison on the target, without PyTorch.",
        ),
    ] = None,
    triton_dir: Annotated[
        Path | None,
        typer.Option(
            "--triton", metavar="DIR", help="Put the file into this Triton model repository too."
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace an older file, recording and Triton model."),
    ] = False,
    _version: Version = False,
) -> None:
    """Export a checkpoint to one self-contained ONNX file and verify it against PyTorch."""
    if (height is None) != (width is None):
        raise typer.BadParameter("give both --height and --width, or neither")
    size = None if height is None or width is None else (height, width)
    with reported_errors("export,cpu"):
        from export.exporter import export_checkpoint  # here: --help does not wait for PyTorch

        with interruptible():
            report = export_checkpoint(
                checkpoint,
                model,
                size=size,
                dynamic=dynamic,
                opset=opset,
                with_logits=with_logits,
                record_dir=record_dir,
                triton_dir=triton_dir,
                overwrite=overwrite,
            )
    shape = f"{report.size[0]} x {report.size[1]}" + (
        ", any size accepted" if report.dynamic else ""
    )
    typer.echo(f"{report.path}: {report.num_bytes / 1e6:.1f} MB, {shape}, opset {opset}")
    typer.echo(f"largest difference to PyTorch on {report.num_frames} frames:")
    for head, measured in report.parity.items():
        figures = ", ".join(f"{name} {value:.6g}" for name, value in measured.figures.items())
        typer.echo(f"  {head:18} {figures}")
