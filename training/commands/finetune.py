"""`ssdnet-finetune`: the installed weights, or others, trained on your own folders."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

import training
from runtime.command.options import Version
from training.base.palette import PaletteOption
from training.commands.options import (
    EXIT_CODES,
    Begin,
    Changes,
    Device,
    DryRun,
    Out,
    StopAfter,
    Threads,
    end_run,
    list_options,
    print_next_commands,
    training_command,
)

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog=EXIT_CODES)
def finetune(
    images: Annotated[
        Path, typer.Argument(help="Folder of PNG or JPEG images, or a recording of ssdnet-run.")
    ],
    *,
    labels: Annotated[
        Path | None,
        typer.Option(
            help="Folder of PNGs of class ids, named like the images, 255 is no class, "
            "or of colours that --classes or --palette states."
        ),
    ] = None,
    classes: Annotated[
        Path | None,
        typer.Option(
            help="Text file with the names of the classes of --labels, one a line, in the order of "
            "their ids, or with their colours, road 128 64 128; CVAT's labelmap.txt is one."
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CLASS",
            help="Class of --classes that is not learned: its pixels count as unlabelled; may be "
            "repeated.",
        ),
    ] = None,
    palette: PaletteOption = None,
    depth: Annotated[
        Path | None,
        typer.Option(
            help="Folder of LiDAR depth: 16-bit PNGs of metres x 256, named like the images. 0 is "
            "no return."
        ),
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(min=1e-6, help="Units of --depth per metre.", show_default="256"),
    ] = None,
    focal_length_px: Annotated[
        float | None,
        typer.Option(
            "--focal-length",
            min=1,
            help="Focal length of the images in pixels, with the optical axis in the middle.",
        ),
    ] = None,
    intrinsics: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="FX FY CX CY",
            help="Intrinsics of the images in pixels, instead of --focal-length.",
        ),
    ] = None,
    points: Annotated[Path | None, typer.Option(help="Scans, see ssdnet-run.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration, see ssdnet-run.")] = None,
    out: Out,
    init: Begin = "ssdnet-lite",
    changes: Changes = None,
    device: Device = "cpu",
    threads: Threads = None,
    folds: Annotated[
        int,
        typer.Option(
            min=0,
            help="Score on all images: train so often (5) without a block of them each, then on "
            "all.",
        ),
    ] = 0,
    stop_after: StopAfter = None,
    dry_run: DryRun = False,
    _version: Version = False,
) -> None:
    """Train the classes or the depth of a network on your own images.

    A recipe is made for the folders, shown on stderr, and written to recipe.toml below --out: edit
    it, and train by it with ssdnet-train, to change more.
    """
    with training_command(locals()) as options:
        found = training.finetune(**options)
        end_run(found, options["stop"])
        if dry_run or found.stopped:
            return
        if labels is not None or depth is not None:
            test: dict[str, object] = {
                "images": "TEST/images",
                "labels": labels and "TEST/labels",
                "classes": classes,
                "palette": palette,
                "depth": depth and "TEST/depth",
                "depth-scale": depth_scale,
            }
            typer.echo(shlex.join(["ssdnet-eval", init, str(out), *list_options(test)]))
        given: dict[str, object] = {"depth": depth, "points": points, "calibration": calibration}
        given["focal-length"] = focal_length_px
        print_next_commands(str(images), given, found.path)
