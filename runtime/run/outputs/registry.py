"""The outputs of a run. A new one: its file, a row here, and its option in `RunOptions`."""

from collections.abc import Callable
from contextlib import AbstractContextManager

from runtime.run.outputs.frame_writer import open_frame_files
from runtime.run.outputs.mcap import open_mcap
from runtime.run.outputs.output import OpenRun, Output
from runtime.run.outputs.rerun_log import open_rerun
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

#: Option -> what opens its output, in the order of opening. They are closed in reverse: report.json
#: and the page are written when all others are whole.
OUTPUTS: dict[str, OpenOutput] = {
    "report": open_page,
    "out": open_frame_files,
    "video": open_video,
    "mcap": open_mcap,
    "rerun": open_rerun,
}
#: The same for outputs that get each answer as the predictor gave it, valid or not, while nothing
#: is predicted.
RECORDERS: dict[str, OpenOutput] = {"record": open_recording}
