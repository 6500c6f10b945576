"""`ssdnet-eval`: the metrics of Table 1 for checkpoints, files and methods, a row each."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from runtime.app.command import reported_errors, stop_requested
from runtime.app.command_options import Version
from runtime.base.errors import InputError

if TYPE_CHECKING:
    from training.evaluation.score_report import Row

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command()
def evaluate(
    models: Annotated[
        list[str],
        typer.Argument(
            help="Checkpoints (*.pt), exported models (*.onnx), bundled models by name "
            "(ssdnet-lite) and classical methods (nearest, linear, planes, ip-basic, "
            "ip-basic-multiscale, mrf, tgv)."
        ),
    ],
    data: Annotated[
        list[str],
        typer.Option(
            help="KIND:FOLDER[,KEY=VALUE...], a data set as in a recipe, for example "
            "cityscapes:/data/cityscapes,split=val,size=[512,1024]; may be repeated."
        ),
    ],
    lidar: Annotated[
        str,
        typer.Option(
            help="LiDAR inputs to score: own,64,32,16,8,4,2,1,random:SHARE,none; comma-separated."
        ),
    ] = "own",
    faults: Annotated[
        str,
        typer.Option(
            help="Also score with simulated LiDAR faults: nan,shift,dropout; comma-separated."
        ),
    ] = "",
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
        bool, typer.Option("--all", help="Print all metrics instead of the main ones.")
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write all metrics to this file.")] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            help="Write the depth of every answer below this folder, as 16-bit PNGs of metres x "
            "256 in MODEL/SET/LIDAR/FRAME.png, also of frames without ground truth."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace depth of the same names below --save.")
    ] = False,
    _version: Version = False,
) -> None:
    """Score models on data sets; prints a table."""
    with reported_errors("cpu,train"):
        # Heavy imports here, so that --help answers at once.
        from runtime.contract.network_size import parse_network_size
        from runtime.files.atomic_write import require_writable
        from training.evaluation.evaluate import DepthFolder
        from training.evaluation.evaluate import evaluate as run
        from training.evaluation.score_report import format_table, write_json
        from training.lidar.split import LidarInput
        from training.recipe import parse_data

        if json is not None:
            require_writable(json)
        folder = None if save is None else DepthFolder(save, overwrite)
        if folder is not None:
            folder.require_free()
        with stop_requested(interrupts=True):
            rows: list[Row] = run(
                models,
                [parse_data(text) for text in data],
                lidars=[
                    *dict.fromkeys(LidarInput.parse(text.strip()) for text in lidar.split(","))
                ],
                faults=["none", *_parse_faults(faults)],
                device=device,
                threads=threads,
                size=parse_network_size(size),
                limit=limit,
                save=folder,
            )
            typer.echo(format_table(rows, all_columns=all_columns))
            if json is not None:
                write_json(rows, json)


def _parse_faults(text: str) -> list[Any]:
    from training.lidar.faults import Fault

    known = [fault for fault in get_args(Fault) if fault != "none"]
    names = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"--faults {unknown[0]!r}; known: {', '.join(known)}.")
    return names
