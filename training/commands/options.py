"""Options that the training commands share, and how these commands end."""

# ruff: noqa: RUF009 - what is called in classes of options returns a field

import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from runtime.command.options import option_group
from runtime.command.process import INTERRUPTED, reported_errors
from training.base.stop_signal import Stop, stop_signal

if TYPE_CHECKING:  # heavy, and --help is to be quick
    from training.run.training_run import RunResult


# How each of these commands ends, for its help.
EXIT_CODES = (
    "Exit codes: 0 done; 1 error; 2 usage; 130 stopped by Ctrl-C, SIGTERM or SIGHUP, after which "
    "the same command resumes."
)
option = option_group()


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of every command that trains; functions of `training` take them by these names."""

    out: Path = option(
        "Folder of the run. A run that was stopped is resumed by the same command.", default=MISSING
    )
    init: str | None = option(
        "Initial weights: the name of installed weights (ssdnet-lite, ssdnet-nano, ssdnet-open), "
        "or a path that ends in .pt or holds a slash.",
        default="ssdnet-lite",
    )
    changes: list[str] | None = option(
        "Change a key of the recipe, for example 'schedule.steps = 500'. May be repeated.",
        "--set",
        metavar="KEY=VALUE",
    )
    device: str = option("'cpu', 'cuda' or 'cuda:N'.", default="cpu")
    threads: int | None = option("Threads of PyTorch. [default: all cores]", min=1)


@dataclass(frozen=True, kw_only=True)
class StepOptions(RunOptions):
    """Options of a run by a recipe."""

    stop_after: int | None = option(
        "Stop at this step, over all stages. The run can be resumed.", min=1
    )
    dry_run: bool = option(
        "Do not train: check that the training, or its next stage, can start, describe its data, "
        "and draw the first batch as batch.png in --out.",
        "--dry-run",
        default=False,
    )


@contextmanager
def training_command(given: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Report errors, set the threads of PyTorch, and yield the arguments of the function to call.

    These are the options that were given, and `stop`, which says whether a signal arrived.
    """
    with reported_errors("train"), stop_signal() as stop:
        import torch

        if (threads := given.pop("threads")) is not None:
            torch.set_num_threads(threads)
        options = {
            name: value
            for name, value in given.items()
            if value is not None and not name.startswith("_")
        }
        yield {**options, "stop": stop}


def end_run(found: "RunResult", stop: Stop) -> None:
    """Print what a run has made, and end the command if a signal stopped it."""
    typer.echo(str(found))
    if found.stopped and stop():
        text = "stopped before the first step; the same command starts again"
        if found.path.is_file():
            text = f"stopped; the same command resumes from {found.path}"
        typer.echo(text, err=True)
        raise typer.Exit(INTERRUPTED)


def print_next_commands(recording: str, given: Mapping[str, object], checkpoint: Path) -> None:
    """Print the commands that export a model and run it on the recording of its training."""
    from training.fine_tuning.adaptation_frames import is_named

    model = str(checkpoint.with_suffix(".onnx"))
    source = ["--source", recording] if is_named(recording) else [recording]
    typer.echo(shlex.join(["ssdnet-export", str(checkpoint), model]))
    typer.echo(shlex.join(["ssdnet-run", *source, *list_options(given), "--model", model]))


def list_options(given: Mapping[str, object]) -> Iterator[str]:
    """Yield the options of a command that have a value."""
    for name, value in given.items():
        if value is not None:
            yield from (f"--{name}", str(value))
