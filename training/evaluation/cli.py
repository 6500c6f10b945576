"""`ssdnet-eval`: scores of models, predictions and methods on the same frames, and differences."""

import shutil
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from runtime.app.command import print_result, reported_errors, stop_requested
from runtime.app.command_options import Version
from runtime.base.errors import InputError

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
# Characters of a line if the output is not a terminal.
_WIDTH = 120


@app.command()
def evaluate(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MODEL]...",
            help="Folders of runs, checkpoints (*.pt), exported models (*.onnx), networks of "
            "others (*.onnx, see --adapter), bundled models by name (ssdnet-lite) and classical "
            "methods (nearest, linear, planes, ip-basic, ip-basic-multiscale, mrf, tgv). Others "
            "are compared with the first.",
        ),
    ] = None,
    data: Annotated[
        list[str] | None,
        typer.Option(
            help="KIND:FOLDER[,KEY=VALUE...], a data set as in a recipe, for example "
            "cityscapes:/data/cityscapes,split=val,size=[512,1024]; may be repeated. [default: the "
            "validation sets of the first run]"
        ),
    ] = None,
    lidar: Annotated[
        str | None,
        typer.Option(
            help="LiDAR inputs to score: own,64,32,16,8,4,2,1,random:SHARE,none; comma-separated. "
            "[default: that of the run's validation, or own]"
        ),
    ] = None,
    faults: Annotated[
        str,
        typer.Option(
            help="Also score with simulated LiDAR faults: nan,shift,dropout; comma-separated."
        ),
    ] = "",
    predictions: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIR[,KEY=VALUE...]",
            help="Score answers by the names of the frames: PNGs of class ids or palettes, 16-bit "
            "PNGs of depth (depth_scale=256), or .npy; classes=cityscapes or a list names the "
            "ids. May be repeated.",
        ),
    ] = None,
    adapter: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.toml",
            help="What goes into a network of others and what it gives; filled in where the file "
            "is missing. May be repeated, in the order of these networks. [default: of the "
            "network's name, beside it]",
        ),
    ] = None,
    join: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help='Classes that count as one, of sets and models: vehicle = ["car", "truck"].',
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="'cpu', 'cuda' or 'cuda:N'.")] = "cpu",
    threads: Annotated[int, typer.Option(min=1, help="CPU threads.")] = 2,
    size: Annotated[
        str,
        typer.Option(
            help="Size at which models of free size run: auto (about the height they were trained "
            "for, where a frame is much larger), frame (the frame's own), ROWS, or HEIGHTxWIDTH. "
            "Scored at the frame's size."
        ),
    ] = "auto",
    limit: Annotated[
        int | None, typer.Option(min=1, help="Frames of each set, evenly spread.")
    ] = None,
    all_columns: Annotated[
        bool, typer.Option("--all", help="Print all figures instead of the main ones.")
    ] = False,
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write an HTML page: tables, differences, confusion, errors by distance, "
            "reliability of the uncertainty, and the ten worst frames of each model.",
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write all figures to this file.")] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            help="Write the depth of every answer below this folder, as 16-bit PNGs of metres x "
            "256 in MODEL/SET/LIDAR/FRAME.png, also of frames without ground truth."
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace depth below --save, and --page."),
    ] = False,
    _version: Version = False,
) -> None:
    """Score models on data sets; prints a table, and whether the others differ from the first."""
    if not models and not predictions:
        raise typer.BadParameter("name a model, the folder of a run, or --predictions DIR")
    with reported_errors("cpu,train"):
        # Heavy imports are here, so that --help answers at once.
        from runtime.contract.network_size import parse_network_size
        from runtime.files.atomic_write import require_writable
        from training.evaluation.adapter import MissingAdapterError
        from training.evaluation.depth_folder import DepthFolder
        from training.evaluation.evaluate import evaluate as run
        from training.evaluation.evaluate import read_groups
        from training.evaluation.page import WORST, write_page
        from training.evaluation.score_report import format_differences, format_table, write_json

        for file in (json, page):
            if file is not None:
                require_writable(file)
        folder = None if save is None else DepthFolder(save, overwrite)
        if folder is not None:
            folder.require_free()
        with stop_requested(interrupts=True):
            try:
                found = run(
                    models or [],
                    data or [],
                    lidars=None if lidar is None else [text.strip() for text in lidar.split(",")],
                    faults=["none", *_parse_faults(faults)],
                    predictions=predictions or [],
                    adapters=adapter or [],
                    join=None if join is None else read_groups(join),
                    device=device,
                    threads=threads,
                    size=parse_network_size(size),
                    limit=limit,
                    pictures=0 if page is None else WORST,
                    save=folder,
                )
            except MissingAdapterError as error:
                print_result(error.text)
                raise
            width = shutil.get_terminal_size((_WIDTH, 0)).columns
            text = format_table(found.rows, all_columns=all_columns, width=width)
            print_result(text + format_differences(found.differences, width=width))
            if json is not None:
                write_json(found.rows, json, found.differences)
            if page is not None:
                write_page(found, page, overwrite=overwrite)


def _parse_faults(text: str) -> list[Any]:
    from training.lidar.faults import Fault

    known = [fault for fault in get_args(Fault) if fault != "none"]
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"--faults {unknown[0]!r}; known: {', '.join(known)}")
    return names
