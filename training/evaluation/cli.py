"""`ssdnet-eval`: scores of models, predictions and methods on the same frames, and differences."""

import shutil
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from runtime.base.errors import InputError, OutputError
from runtime.command.options import Version
from runtime.command.process import print_result, reported_errors, stop_requested

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
# Characters of a line if the output is not a terminal.
_WIDTH = 120


@app.command()
def evaluate(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="MODEL",
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
            "cityscapes:/data/cityscapes,split=val,size=[512,1024]. May be repeated. [default: the "
            "validation sets of the first run]",
            metavar="DATA",
        ),
    ] = None,
    lidar: Annotated[
        str | None,
        typer.Option(
            metavar="LIDAR,...",
            help="LiDAR inputs to score: own, 64, 32, 16, 8, 4, 2, 1, random:SHARE, none. "
            "[default: that of the run's validation, or own]",
        ),
    ] = None,
    faults: Annotated[
        str,
        typer.Option(
            metavar="FAULT,...",
            help="Score also with simulated faults of the LiDAR: nan, shift, dropout.",
        ),
    ] = "",
    predictions: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIR[,KEY=VALUE...]",
            help="Folder of answers to score, named like the frames: PNGs of class ids or with "
            "palettes, 16-bit PNGs of depth (depth_scale=256), or .npy files. classes=cityscapes "
            "or a list names the ids. May be repeated.",
        ),
    ] = None,
    adapter: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.toml",
            help="File that says what goes into a network of others and what it returns; if it is "
            "missing, a draft is printed. May be repeated, in the order of these networks. "
            "[default: the file beside the network, with its name]",
        ),
    ] = None,
    join: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help='Classes of data sets and models that count as one: vehicle = ["car", "truck"].',
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="'cpu', 'cuda' or 'cuda:N'.")] = "cpu",
    threads: Annotated[int, typer.Option(min=1, help="CPU threads.")] = 2,
    size: Annotated[
        str,
        typer.Option(
            help="Size at which models of free size run: auto (about the height that they were "
            "trained for, if a frame is much larger), frame, ROWS, or HEIGHTxWIDTH. Scores are "
            "computed at the size of the frame."
        ),
    ] = "auto",
    limit: Annotated[
        int | None, typer.Option(min=1, help="Frames to score of each set, evenly spread.")
    ] = None,
    farthest: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="Farthest true depth that is scored [m]. [default: that of the run's validation, "
            "or 100]",
        ),
    ] = None,
    all_columns: Annotated[
        bool, typer.Option("--all", help="Print all figures instead of the main ones.")
    ] = False,
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write an HTML page with the tables, the differences, the confusion of classes, "
            "the errors by distance, the reliability of the uncertainty, and the ten worst frames "
            "of each model.",
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write all figures to this file.")] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            help="Write the depth of every frame below this folder, also of frames without ground "
            "truth: 16-bit PNGs of metres x 256 as MODEL/SET/LIDAR/FRAME.png."
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace the depth in --save, and the file of --page."),
    ] = False,
    _version: Version = False,
) -> None:
    """Score models on data sets.

    Prints a table, and for each model whether it differs from the first beyond chance.
    """
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
        if page is not None and page.exists() and not overwrite:
            raise OutputError(f"{page} exists: choose another name, or replace it with --overwrite")
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
                    farthest_m=farthest,
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
