"""`ssdnet-adapt`: the depth of a network adapted to a camera and a LiDAR, without labels."""

# ruff: noqa: RUF009 - what is called in classes of options returns a field

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

import typer

import training
from runtime.command.options import with_options
from training.commands.options import (
    EXIT_CODES,
    RunOptions,
    end_run,
    option,
    print_next_commands,
    training_command,
)

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@dataclass(frozen=True, kw_only=True)
class _Recording:
    """Options that name the recording."""

    recording: str = option(
        "A recording of your camera and LiDAR: a path, or KIND:PATH[,KEY=VALUE...] like --source "
        "of ssdnet-run. Folders of images need --depth, or --points and --calibration.",
        default=MISSING,
        kind=typer.Argument,
    )
    depth: Path | None = option("Depth maps, see ssdnet-run.")
    points: Path | None = option("Scans, see ssdnet-run.")
    calibration: Path | None = option("Calibration, see ssdnet-run.")
    poses: Path | None = option("Poses, see ssdnet-run.")


@dataclass(frozen=True, kw_only=True)
class _Options(RunOptions, _Recording):  # the options of the last class come first
    pass


@app.command(epilog=EXIT_CODES)
@with_options(_Options)
def adapt(**given: Any) -> None:
    """Adapt the depth of a network to your camera and LiDAR, by a recording without labels.

    The returns of the recording train the depth; classes and boundaries stay as they are. Prints
    the scores before and after, and what to run next.
    """
    with training_command(given) as options:
        found = training.adapt(**options)
        end_run(found, options["stop"])
        if found.paid:
            files = ("depth", "points", "calibration", "poses")
            named = {name: given[name] for name in files}
            print_next_commands(given["recording"], named, found.path)
