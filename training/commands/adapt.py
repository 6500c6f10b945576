"""`ssdnet-adapt`: the depth of a network adapted to a camera and a LiDAR, without labels."""

from pathlib import Path
from typing import Annotated

import typer

import training
from runtime.command.options import Version
from training.commands.options import (
    EXIT_CODES,
    Begin,
    Changes,
    Device,
    Out,
    Threads,
    end_run,
    print_next_commands,
    training_command,
)

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(epilog=EXIT_CODES)
def adapt(
    recording: Annotated[
        str,
        typer.Argument(
            help="A recording of your camera and LiDAR: a path, or KIND:PATH[,KEY=VALUE...] like "
            "--source of ssdnet-run. Folders of images need --depth, or --points and --calibration."
        ),
    ],
    *,
    depth: Annotated[Path | None, typer.Option(help="Depth maps, see ssdnet-run.")] = None,
    points: Annotated[Path | None, typer.Option(help="Scans, see ssdnet-run.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration, see ssdnet-run.")] = None,
    poses: Annotated[Path | None, typer.Option(help="Poses, see ssdnet-run.")] = None,
    out: Out,
    init: Begin = "ssdnet-lite",
    changes: Changes = None,
    device: Device = "cpu",
    threads: Threads = None,
    _version: Version = False,
) -> None:
    """Adapt the depth of a network to your camera and LiDAR, by a recording without labels.

    The returns of the recording train the depth; classes and boundaries stay as they are. Prints
    the scores before and after, and what to run next.
    """
    with training_command(locals()) as options:
        found = training.adapt(**options)
        end_run(found, options["stop"])
        if found.paid:
            files = ("depth", "points", "calibration", "poses")
            given = {name: options.get(name) for name in files}
            print_next_commands(recording, given, found.path)
