"""`ssdnet-eval`: scores of models, predictions and methods on the same frames, and differences."""

import shlex
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from runtime.base.errors import InputError
from runtime.command.options import Version
from runtime.command.process import print_result, reported_errors, stop_requested
from runtime.files.atomic_write import atomic_write
from runtime.files.read_input import read_toml
from training.base.palette import PaletteOption

if TYPE_CHECKING:
    from training.evaluation.options import EvaluationOptions

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
            "cityscapes:/data/cityscapes,split=val,size=[512,1024]; name=TEXT is its title. May be "
            "repeated. [default: the validation sets of the first run]",
            metavar="DATA",
        ),
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of your own images, as for ssdnet-finetune."),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Labels of --images: PNGs of class ids or of colours."),
    ] = None,
    classes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Names of the classes of --labels, as for ssdnet-finetune. [default: those of the "
            "first run]",
        ),
    ] = None,
    palette: PaletteOption = None,
    depth: Annotated[
        Path | None, typer.Option(metavar="DIR", help="LiDAR depth of --images: 16-bit PNGs.")
    ] = None,
    depth_scale: Annotated[
        float | None, typer.Option(min=1e-6, help="Units of --depth per metre. [default: 256]")
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
            help="Score also with simulated faults of the LiDAR (nan, shift, dropout) or the "
            "camera (blurred, dark, noisy, overexposed, covered, black, grey, white).",
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
        from training.evaluation.options import EvaluationOptions
        from training.evaluation.own_frames import OwnFrames

        if images is None and (labels or classes or palette or depth or depth_scale):
            raise InputError(
                "--labels, --classes, --palette and --depth belong to --images: give it"
            )
        own = None
        if images is not None:
            own = OwnFrames(images, labels, classes, palette, depth, depth_scale)
        options = EvaluationOptions(
            models=models or (),
            data=data or (),
            frames=own,
            lidars=None if lidar is None else _split(lidar),
            faults=("none", *_split(faults)),  # type: ignore[arg-type]  # checked there
            predictions=predictions or (),
            adapters=adapter or (),
            join=None if join is None else _read_groups(join),
            device=device,
            threads=threads,
            size=parse_network_size(size),
            limit=limit,
            farthest_m=farthest,
            page=page,
            json=json,
            save=save,
            overwrite=overwrite,
        )
        with stop_requested(interrupts=True):
            _score(options, all_columns=all_columns)


def _score(options: "EvaluationOptions", *, all_columns: bool) -> None:
    """Score, print the tables, and write the files."""
    from training.evaluation.adapter import MissingAdapterError
    from training.evaluation.evaluate import score_models
    from training.pages.page import write_page
    from training.scores.score_report import format_differences, format_table, write_json

    try:
        found = score_models(options)
    except MissingAdapterError as error:
        print_result(error.text)
        raise
    width = shutil.get_terminal_size((_WIDTH, 0)).columns
    text = format_table(found.rows, all_columns=all_columns, width=width)
    print_result(text + format_differences(found.differences, width=width))
    if found.draft:
        alone = dict.fromkeys(row.left_out for row in found.rows if row.left_out)
        _print_draft(found.draft, list(alone), options.page)
    if options.json is not None:
        write_json(found.rows, options.json, found.differences)
    if options.page is not None:
        write_page(
            found.results,
            options.page,
            differences=found.differences,
            worst=found.worst,
            overwrite=options.overwrite,
        )


def _print_draft(
    groups: "Mapping[str, Sequence[str]]", alone: Sequence[str], page: Path | None
) -> None:
    """Print a draft of --join, which is written beside a page, and the command that goes on."""
    from training.base.tables import to_toml

    path = Path("join.toml") if page is None else page.with_suffix(".join.toml")
    text = "\n".join((to_toml(groups), *(f"# {line}" for line in alone), ""))
    if page is not None:
        atomic_write(path, text.encode())
    done = "written to" if page is not None else "to be saved as"
    further = [
        "--join",
        str(path),
        *["--overwrite"] * ("--overwrite" not in sys.argv and bool(page)),
    ]
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:], *further])
    print_result(
        f"\nSo few labels are scored because names differ. Classes that may mean the same, {done} "
        f"{path}; check them, and go on by\n{command}\n\n{text}"
    )


def _split(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _read_groups(path: Path) -> dict[str, list[str]]:
    """Read a TOML file of joint classes, `vehicle = ["car", "truck"]`. Raises InputError."""
    groups = read_toml(path)
    for group, names in groups.items():
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(
                f'{path}: {group} is not a list of classes: write {group} = ["car", "truck"]'
            )
    return groups
