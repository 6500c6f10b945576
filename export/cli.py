"""`ssdnet-export`: a checkpoint in, one verified ONNX file out."""

from typing import Annotated, Any

import typer

from export.options import ExportOptions
from export.precision import ENOUGH_FRAMES
from runtime.command.options import read_options, with_options
from runtime.command.process import reported_errors, stop_requested
from runtime.contract.contract import MIN_SIDE, Contract

# Key in `Contract.accuracy`, name, factor and unit of each figure.
_FIGURES = (
    ("miou", "mIoU", 1e2, "%"),
    ("boundary_f", "boundary F", 1e2, "%"),
    ("mae_m", "MAE", 1e3, "mm"),
    ("coverage_1", "errors within one scale", 1e2, "%"),
)


app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog="Exit codes: 0 done; 1 error, nothing was written; 2 usage.")
@with_options(ExportOptions)
def export(
    *,
    height: Annotated[
        int | None,
        typer.Option(
            min=MIN_SIDE,
            help="Accept images of this height alone, together with --width. All shapes in the "
            "graph are then constants, which some compilers and accelerators need. [default: any]",
        ),
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=MIN_SIDE, help="Width that goes with --height. [default: any]")
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="CPU threads. [default: all cores]")
    ] = None,
    **given: Any,
) -> None:
    """Export a checkpoint to one self-contained ONNX file and verify it against PyTorch."""
    model = given["onnx_path"]
    if model.suffix != ".onnx":
        right = model.with_name(model.name.removesuffix(".pt") + ".onnx")
        raise typer.BadParameter(f"an exported file ends in .onnx, got {model.name}: give {right}")
    if (height is None) != (width is None):
        raise typer.BadParameter("give both --height and --width, or neither")
    with reported_errors("export,train,cpu" if given["validate"] else "export,cpu"):
        import torch  # slow, and --help needs no PyTorch

        from export.exporter import run_export

        if threads is not None:
            torch.set_num_threads(threads)
        size = None if height is None or width is None else (height, width)
        options = read_options(ExportOptions, given, size=size)
        with stop_requested(interrupts=True):
            report = run_export(options, _print_stage)
    free = ", any size accepted" if report.dynamic else ""
    shape = f"{report.size[0]} x {report.size[1]}{free}"
    typer.echo(f"{report.path}: {report.num_bytes / 1e6:.1f} MB, {shape}, opset {options.opset}")
    typer.echo(f"largest difference to PyTorch on {report.num_frames} frames:")
    for head, measured in report.parity.items():
        figures = ", ".join(f"{name} {value:.6g}" for name, value in measured.figures.items())
        typer.echo(f"  {head:18} {figures}")
    _print_accuracy(report.contract)


def _print_stage(finished: int, stages: int, text: str) -> None:
    """Print a bar and what is done next on stderr."""
    bar = "#" * finished + "-" * (stages - finished)
    typer.echo(f"[{bar}] {finished + 1}/{stages} {text}", err=True)


def _print_accuracy(contract: Contract) -> None:
    """Print the convolutions left in float, and the accuracy on each set in float and in int8."""
    quantization = contract.quantization or {}
    for warning in quantization.get("warnings", ()):
        typer.echo(f"warning: {warning}", err=True)
    if quantization:
        in_float = ", ".join(quantization["float_convolutions"]) or "none"
        typer.echo(
            f"int8, calibrated on {quantization['calibration_frames']} frames; convolutions left "
            f"in float: {in_float}"
        )
    if contract.accuracy is None:
        return
    rows = contract.accuracy["rows"]
    for before, row in zip(quantization.get("accuracy_fp32", rows), rows, strict=True):
        versions = [before, row] if quantization else [row]
        figures = []
        for key, name, factor, unit in _FIGURES:
            if row[key] is not None:
                values = " -> ".join(f"{factor * each[key]:.4g}" for each in versions)
                figures.append(f"{name} {values} {unit}")
        typer.echo(
            f"  {row['data']}, LiDAR {row['lidar']}, {row['frames']} frames: {', '.join(figures)}"
        )
    for data, frames in {row["data"]: row["frames"] for row in rows}.items():
        if frames < ENOUGH_FRAMES:
            typer.echo(
                f"{data} has {frames} frames, fewer than {ENOUGH_FRAMES}: small differences on it "
                "may not be significant"
            )
    typer.echo(f"measure it again: {contract.accuracy['repeat']}")
    if not_gated := quantization.get("not_gated"):
        typer.echo(f"not gated: {'; '.join(not_gated)}")
