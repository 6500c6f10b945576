"""What the outputs of a run share while it is open."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from runtime.drawing.overlay import Overlay
from runtime.predictor import Predictor
from runtime.run.options import RunOptions
from runtime.run.run_report import RunReport


@dataclass
class OpenRun:
    """A run of one camera while it is open: what an output may need.

    Attributes:
        options: of the run.
        predictor: of the run.
        kinds: of SUFFIXES, the files of a frame to write.
        names: of the frames.
        report: set after the last frame, before the outputs are closed.
    """

    options: RunOptions
    predictor: Predictor
    kinds: Sequence[str] = ()
    names: Sequence[str] = ()
    report: RunReport = field(init=False)

    @cached_property
    def overlay(self) -> Overlay:
        """Draws the frames."""
        contract = self.predictor.contract
        return Overlay(contract.classes, contract.max_depth_m)
