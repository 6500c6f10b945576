"""The outputs of a run. A new one needs a file, a row here, and its option in `RunOptions`."""

import contextlib
import importlib.util
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import NamedTuple

from runtime.app.run.options import SUFFIXES, RunOptions
from runtime.app.run.outputs.frame_writer import open_frame_files
from runtime.app.run.outputs.mcap import open_mcap
from runtime.app.run.outputs.page import open_page
from runtime.app.run.outputs.reference import open_reference
from runtime.app.run.outputs.run_context import RunContext
from runtime.app.run.outputs.video import open_video
from runtime.app.run.pipeline import Output, Outputs
from runtime.base.errors import OutputError, install_command
from runtime.files.atomic_write import require_writable
from runtime.files.own_folder import require_folder_free
from runtime.recordings.source import Source

# Opens an output.
#
# Args:
#     run: the options, and what the outputs share; its report is set before they are closed.
#
# Yields:
#     The output; None if it takes no frames.
#
# Raises:
#     OutputError: if it cannot be opened, and, when the block ends, if it is not whole.
OpenOutput = Callable[[RunContext], AbstractContextManager[Output | None]]


class OutputRow(NamedTuple):
    """An output of a run.

    Attributes:
        open: opens the output.
        package: import name of a package that the output needs; None: it needs none.
        extra: the extra that installs the package.
        is_recorder: whether the output is one of `Outputs.recorders`.
    """

    open: OpenOutput
    package: str | None = None
    extra: str = ""
    is_recorder: bool = False


# The outputs by option, in the order in which they are opened. They are closed in reverse order,
# so that report.json and the page are written after all other files are complete.
OUTPUTS: dict[str, OutputRow] = {
    "page": OutputRow(open_page),
    "out": OutputRow(open_frame_files),
    "video": OutputRow(open_video),
    "mcap": OutputRow(open_mcap, package="rosbags", extra="bag"),
    "record": OutputRow(open_reference, is_recorder=True),
}


def _requested(options: RunOptions) -> dict[str, OutputRow]:
    """The rows of the given options."""
    return {name: row for name, row in OUTPUTS.items() if getattr(options, name) is not None}


def require_outputs(options: RunOptions, source: Source) -> None:
    """Raise OutputError for an output that cannot be made, before anything is written."""
    answers = {os.path.realpath(options.folder / kind) for kind in SUFFIXES}
    for folder in source.folders:
        if os.path.realpath(folder) in answers:
            raise OutputError(
                f"{folder} is where --out {options.folder} writes its own pictures: choose another "
                "--out"
            )
    for option, row in _requested(options).items():
        if row.package is not None and importlib.util.find_spec(row.package) is None:
            raise OutputError(
                f"--{option} needs the package {row.package}, which is not installed: "
                f"{install_command(row.extra)}"
            )
    inputs = {os.path.realpath(read) for read in source.recordings}
    for path in options.named_files.values():
        require_writable(path, overwrite=options.overwrite, make_parents=True)
        target = os.path.realpath(path)
        if os.path.lexists(path) and {target, os.path.dirname(target)} & inputs:
            raise OutputError(f"{path} is what the run reads: choose another name")
    if options.record is not None:
        require_folder_free(options.record, overwrite=options.overwrite)


@contextlib.contextmanager
def open_outputs(run: RunContext) -> Iterator[Outputs]:
    """Open the requested outputs."""
    writers: list[Output] = []
    recorders: list[Output] = []
    with contextlib.ExitStack() as stack:
        for row in _requested(run.options).values():
            output = stack.enter_context(row.open(run))
            if output is not None:
                (recorders if row.is_recorder else writers).append(output)
        yield Outputs(writers, recorders)
