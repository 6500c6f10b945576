"""What the outputs of a run share while it is open."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from runtime.drawing.overlay import Overlay
from runtime.predictor import Predictor
from runtime.run.options import RunOptions
from runtime.run.run_report import RunReport


@dataclass
class OpenRun:
    """A run while it is open: what an output may need.

    Attributes:
        options: of the run.
        predictor: of the run.
        overlay: draws the frames.
        kinds: of SUFFIXES, the files of a frame to write.
        names: of the frames.
        report: set after the last frame, before the outputs are closed.
    """

    options: RunOptions
    predictor: Predictor
    overlay: Overlay
    kinds: Sequence[str] = ()
    names: Collection[str] = ()
    report: RunReport | None = None
