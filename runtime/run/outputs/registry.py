"""The outputs of a run. A new one: its file, a row here, and its option in `RunOptions`."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import NamedTuple

from runtime.run.options import RunOptions
from runtime.run.outputs.frame_writer import open_frame_files
from runtime.run.outputs.mcap import open_mcap
from runtime.run.outputs.output import OpenRun, Output
from runtime.run.outputs.run_page import open_page
from runtime.run.outputs.run_recording import open_recording
from runtime.run.outputs.video import open_video

#: Opens an output.
#:
#: Args:
#:     run: the options, and what the outputs share; its report is set before they are closed.
#:
#: Yields:
#:     The output; None if it takes no frames.
#:
#: Raises:
#:     OutputError: if it cannot be opened, and, when the block ends, if it is not whole.
OpenOutput = Callable[[OpenRun], AbstractContextManager[Output | None]]


class OutputRow(NamedTuple):
    """An output of a run.

    Attributes:
        open: opens it.
        package: that it needs, by the name of its import; None = none.
        extra: that installs the package.
        raw: whether it gets each answer as the predictor gave it, valid or not, while nothing is
            predicted.
        always: whether it is open also where its option is not given.
    """

    open: OpenOutput
    package: str | None = None
    extra: str = ""
    raw: bool = False
    always: bool = False


#: Option -> its output, in the order of opening. Outputs are closed in reverse order, so that
#: report.json and the page are written after all other files are complete.
OUTPUTS: dict[str, OutputRow] = {
    "record": OutputRow(open_recording, raw=True),
    "report": OutputRow(open_page),
    "out": OutputRow(open_frame_files, always=True),
    "video": OutputRow(open_video),
    "mcap": OutputRow(open_mcap, package="rosbags", extra="bag"),
}


def requested_outputs(options: RunOptions) -> dict[str, OutputRow]:
    """Return the rows of the outputs of a run, in their order."""
    return {name: row for name, row in OUTPUTS.items() if row.always or getattr(options, name)}
