"""`ssdnet-train`: from a recipe to a checkpoint."""

import shlex
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from runtime.app.command import INTERRUPTED, reported_errors
from runtime.app.command_options import Version
from training.stop_signal import stop_signal

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


def _print_recipes(wanted: bool) -> None:
    if wanted:
        with reported_errors("train"):
            from training.recipes.registry import RECIPES

        for name, recipe in RECIPES.items():
            typer.echo(f"{name:28} {recipe.description}")
        raise typer.Exit


@app.command(
    epilog="Exit codes: 0 done; 1 error; 2 usage; 130 stopped by Ctrl-C or SIGTERM, after which "
    "the same command resumes."
)
def train(
    recipe: Annotated[
        str | None,
        typer.Argument(
            help="Name of a recipe, see --list, or a path that ends in .toml or holds a slash.",
            show_default=False,
        ),
    ] = None,
    *,
    data: Annotated[
        list[Path] | None, typer.Option(help="Folder with the recipe's data sets. May be repeated.")
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(
            help="PNG or JPEG images. In place of a recipe and --data, with --init: a recipe is "
            "made for these folders, printed, and written to recipe.toml below --out."
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(help="Class ids (0, 1, ...; 255 = none) of --images: PNGs of the same names."),
    ] = None,
    depth: Annotated[
        Path | None,
        typer.Option(
            help="LiDAR depth of --images: 16-bit PNGs of the same names, metres x 256, 0 = none."
        ),
    ] = None,
    classes: Annotated[
        Path | None,
        typer.Option(help="Text file for --labels: the name of a class a line, in order of ids."),
    ] = None,
    adapt: Annotated[
        str | None,
        typer.Option(
            metavar="RECORDING",
            help="A recording of your camera and LiDAR, a path or --source of ssdnet-run. In place "
            "of a recipe and --data: its returns train the depth of --init (ssdnet-lite), and "
            "classes stay what they are. Folders of images need --depth, or --points and "
            "--calibration.",
        ),
    ] = None,
    points: Annotated[Path | None, typer.Option(help="Scans of --adapt, as of ssdnet-run.")] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration of --adapt, as of ssdnet-run.")
    ] = None,
    poses: Annotated[Path | None, typer.Option(help="Poses of --adapt, as of ssdnet-run.")] = None,
    out: Annotated[
        Path, typer.Option(help="Folder of the run. A run of the same recipe is resumed.")
    ],
    init: Annotated[
        str | None,
        typer.Option(
            help="Initial weights: the name of installed weights (ssdnet-lite), or a path that "
            "ends in .pt or holds a slash. What a TOML file leaves out comes from their training."
        ),
    ] = None,
    teacher: Annotated[
        str | None,
        typer.Option(
            help="Weights whose answers are learned beside the labels: a name or path as in --init."
        ),
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Change a key of the recipe, for example 'schedule.steps = 500'."
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="'cpu', 'cuda' or 'cuda:N'.")] = "cpu",
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of PyTorch; all cores by default.")
    ] = None,
    stop_after: Annotated[
        int | None,
        typer.Option(min=1, help="Stop at this step, over all stages. The run can be resumed."),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Check that the training, or its next stage, can start, describe its data, and "
            "draw its first batch in batch.png below --out, instead of training.",
        ),
    ] = False,
    _list: Annotated[
        bool,
        typer.Option("--list", callback=_print_recipes, is_eager=True, help="List the recipes."),
    ] = False,
    _version: Version = False,
) -> None:
    """Train a network; writes checkpoints, TensorBoard curves, scores and the resolved recipe."""
    if adapt is not None:
        if recipe or data or images or labels or classes or teacher or stop_after or dry_run:
            raise typer.BadParameter(
                "--adapt goes with --depth, --points, --calibration, --poses, --out, --init, "
                "--set, --device and --threads alone"
            )
        files = {"depth": depth, "points": points, "calibration": calibration, "poses": poses}
        _adapt(adapt, files, out, init or "ssdnet-lite", change or (), device, threads)
        return
    if points or calibration or poses:
        raise typer.BadParameter("--points, --calibration and --poses go with --adapt")
    if recipe is not None and (not data or images or labels or depth or classes):
        raise typer.BadParameter(
            "a recipe needs --data, and none of --images and what goes with it"
        )
    if recipe is None and (data or not images or not init):
        raise typer.BadParameter("give a recipe and --data, or --images and --init; see --help")
    if recipe is None and not (labels or depth):
        raise typer.BadParameter("--images needs --labels, --depth or both")
    if (labels is None) != (classes is None):
        raise typer.BadParameter("--labels and --classes go together")
    with reported_errors("train"):
        # Heavy imports here, so that --help is quick.
        from training.chosen_recipe import fine_tune, read_stages
        from training.dry_run import dry_run as draw_first_batch
        from training.initial_weights import find_weights, read_weights
        from training.own_folders import RECIPE_TEXT, OwnFolders, keep_recipe
        from training.recipe import build_recipe
        from training.stages import Stage, next_stage, train_stages

        _set_threads(threads)
        with stop_signal() as stop:
            weights, taught_by = (
                None if text is None else read_weights(find_weights(text))
                for text in (init, teacher)
            )
            if recipe is not None:
                stages = read_stages(recipe, change or (), weights)
            else:
                assert images is not None  # checked above, like --init
                assert weights is not None
                own = OwnFolders(images, labels, depth, classes)
                text, data = own.make_recipe(weights), [own.root]
                typer.echo(text)
                table = fine_tune(tomllib.loads(text), change or (), weights)
                stages = (Stage("", build_recipe(table, out / RECIPE_TEXT)),)
                if not dry_run:
                    keep_recipe(text, out)
            assert data is not None
            if dry_run:
                stage, folder, weights = next_stage(stages, out, weights, data)
                path, lines = draw_first_batch(
                    stage.recipe,
                    data=data,
                    out=folder,
                    init=weights,
                    teacher=taught_by,
                    device=device,
                )
                for line in lines:
                    typer.echo(line)
            else:
                path = train_stages(
                    stages,
                    data=data,
                    out=out,
                    init=weights,
                    teacher=taught_by,
                    device=device,
                    stop_after=stop_after,
                    stop=stop,
                )
    typer.echo(str(path))
    if stop() and path.name == "last.pt":
        _end_stopped(path)


def _set_threads(threads: int | None) -> None:
    import torch

    if threads is not None:
        torch.set_num_threads(threads)


def _end_stopped(last: Path) -> None:
    typer.echo(f"stopped; the same command resumes from {last}", err=True)
    raise typer.Exit(INTERRUPTED)


def _adapt(
    text: str,
    files: Mapping[str, Path | None],
    out: Path,
    init: str,
    changes: Sequence[str],
    device: str,
    threads: int | None,
) -> None:
    """Adapt ``init`` to a recording, and print what came of it and what to run next."""
    with reported_errors("train"):
        from runtime.recordings.registry import SOURCES, detect_source, open_source, parse_source
        from training.adapt import adapt
        from training.initial_weights import find_weights, read_weights

        _set_threads(threads)
        is_named = text.partition(":")[0] in SOURCES
        kind, path, keys = parse_source(text) if is_named else detect_source(Path(text))
        with stop_signal() as stop, open_source(kind, path, **files, **keys) as source:
            for note in source.notes:
                typer.echo(note, err=True)
            weights = read_weights(find_weights(init))
            found = adapt(source, weights, out, changes=changes, device=device, stop=stop)
    for line in found.lines:
        typer.echo(line)
    if not found.lines:
        _end_stopped(found.path)
    if not found.paid:
        return
    model = str(found.path.with_suffix(".onnx"))
    recording = ["--source", text] if is_named else [text]
    for name, file in files.items():
        recording += [] if file is None else [f"--{name}", str(file)]
    typer.echo(shlex.join(["ssdnet-export", str(found.path), model]))
    typer.echo(shlex.join(["ssdnet-run", *recording, "--model", model]))
