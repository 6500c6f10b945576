"""`ssdnet-finetune`: the installed weights, or others, trained on your own folders."""

# ruff: noqa: RUF009 - what is called in classes of options returns a field

import shlex
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

import typer

import training
from runtime.command.options import with_options
from training.base.palette import PALETTE_HELP, Palette
from training.commands.options import (
    EXIT_CODES,
    StepOptions,
    end_run,
    list_options,
    option,
    print_next_commands,
    training_command,
)

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@dataclass(frozen=True, kw_only=True)
class _Frames:
    """Options that name the frames, and say what their files mean."""

    images: Path = option(
        "Folder of PNG or JPEG images, or a recording of ssdnet-run.",
        default=MISSING,
        kind=typer.Argument,
    )
    labels: Path | None = option(
        "Folder of PNGs of class ids, named like the images, 255 is no class, or of colours that "
        "--classes or --palette states."
    )
    classes: Path | None = option(
        "Text file with the names of the classes of --labels, one a line, in the order of their "
        "ids, or with their colours, road 128 64 128; CVAT's labelmap.txt is one."
    )
    ignore: list[str] | None = option(
        "Class of --classes that is not learned: its pixels count as unlabelled; may be repeated.",
        metavar="CLASS",
    )
    palette: Palette | None = option(PALETTE_HELP)
    depth: Path | None = option(
        "Folder of LiDAR depth: 16-bit PNGs of metres x 256, named like the images. 0 is no return."
    )
    depth_scale: float | None = option("Units of --depth per metre.", min=1e-6, show_default="256")
    focal_length_px: float | None = option(
        "Focal length of the images in pixels, with the optical axis in the middle.",
        "--focal-length",
        min=1,
    )
    intrinsics: tuple[float, float, float, float] | None = option(
        "Intrinsics of the images in pixels, instead of --focal-length.", metavar="FX FY CX CY"
    )
    points: Path | None = option("Scans, see ssdnet-run.")
    calibration: Path | None = option("Calibration, see ssdnet-run.")


@dataclass(frozen=True, kw_only=True)
class _Options(StepOptions, _Frames):  # the options of the last class come first
    folds: int = option(
        "Score on all images: train so often (5) without a block of them each, then on all.",
        default=0,
        min=0,
    )


@app.command(epilog=EXIT_CODES)
@with_options(_Options)
def finetune(**given: Any) -> None:
    """Train the classes or the depth of a network on your own images.

    A recipe is made for the folders, shown on stderr, and written to recipe.toml below --out: edit
    it, and train by it with ssdnet-train, to change more.
    """
    with training_command(given) as options:
        found = training.finetune(**options)
        end_run(found, options["stop"])
        if given["dry_run"] or found.stopped:
            return
        if "labels" in options or "depth" in options:
            names = ("images", "labels", "classes", "palette", "depth")
            test = {name: options.get(name) for name in names}
            folders = [name for name in ("images", "labels", "depth") if name in options]
            test |= {name: f"TEST/{name}" for name in folders}
            test["depth-scale"] = options.get("depth_scale")
            tested = ["ssdnet-eval", given["init"], str(given["out"])]
            typer.echo(shlex.join([*tested, *list_options(test)]))
        files = {name: options.get(name) for name in ("depth", "points", "calibration")}
        files["focal-length"] = options.get("focal_length_px")
        print_next_commands(str(given["images"]), files, found.path)
