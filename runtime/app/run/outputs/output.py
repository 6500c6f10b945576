"""What the outputs of a run share while it is open."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from runtime.app.drawing.overlay import Overlay
from runtime.app.run.options import RunOptions
from runtime.app.run.run_report import RunReport
from runtime.engine.predictor import Predictor
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult


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

    def draw(
        self, frame: Frame, result: FrameResult, *, widest: int | None = None
    ) -> NDArray[np.uint8]:
        """Draw a frame and its answers, by default as wide as --overlay-width says."""
        widest = self.options.overlay_width or widest
        return self._overlay.draw(frame.rgb, result.prediction, frame.sparse_depth, widest=widest)

    @cached_property
    def _overlay(self) -> Overlay:
        contract = self.predictor.contract
        return Overlay(contract.classes, contract.max_depth_m)
