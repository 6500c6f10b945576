"""The cheap check of a calibration in a run: the first frames as given, and turned by a degree."""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from runtime.alignment.fit_scores import AXES, total_scores
from runtime.alignment.mistakes import find_mistake
from runtime.alignment.view import View, view_of
from runtime.engine.prediction import Prediction
from runtime.streams.frame import Frame

_TURN_DEGREES = 1.0
# Least difference of the sum of both figures, the median of up to five frames. On KITTI, PandaSet
# and View-of-Delft a degree lowers the sum by 0.01 to 0.08 in yaw and pitch, and by 0 to 0.02 in
# roll, which is not judged. A single scene may gain up to 0.02 although its calibration is right.
_LEAST_LOSS, _LEAST_GAIN = 0.005, 0.03
_JUDGED = AXES[:2]


class Fit(StrEnum):
    """What the first frames show."""

    BEST_AS_GIVEN = "best_as_given"
    BETTER_TURNED = "better_turned"
    NOT_VISIBLE = "not_visible"


class QuickFinding(NamedTuple):
    """How well the returns of the first frames fit the image.

    Attributes:
        fit: what the frames show.
        frames: number of frames that were compared.
        figure: sum of the edge and the depth figure as given, median.
        turned: for each axis, the same sum after a turn by -1 and by +1 degree.
        text: the finding in a sentence.
    """

    fit: Fit
    frames: int
    figure: float
    turned: dict[str, tuple[float, float]]
    text: str


class QuickCheck:
    """Collects the first frames of a stream with scans and a calibration."""

    def __init__(self) -> None:
        self._views: list[View] = []

    def add(self, frame: Frame, camera_only: Prediction) -> None:
        """Add a frame; it is ignored if it has no scan or no calibration."""
        if (view := view_of(frame, camera_only)) is not None:
            self._views.append(view)

    def mistake(self) -> str | None:
        """The usual mistake without which the returns would fit the images, or None."""
        mistake = find_mistake(self._views) if self._views else None
        return mistake and mistake.text

    def finding(self) -> QuickFinding | None:
        """What the frames show; None if none of them could be judged."""
        views = [view for view in self._views if view.has_structure]
        if not views:
            return None
        unturned = total_scores(views, (0, 0, 0))
        turned, changes = {}, {}
        for axis, name in enumerate(_JUDGED):
            turns = (way * _TURN_DEGREES * np.eye(3)[axis] for way in (-1, 1))
            minus, plus = (total_scores(views, turn) for turn in turns)
            turned[name] = float(np.median(minus)), float(np.median(plus))
            for sign, figures in (("-", minus), ("+", plus)):
                change = f"{sign}{_TURN_DEGREES:g} degree of {name}"
                changes[change] = float(np.median(figures - unturned))
        best = max(changes, key=lambda change: changes[change])
        if changes[best] > _LEAST_GAIN:
            fit = Fit.BETTER_TURNED
            text = f"the returns fit the images better turned by {best}: run ssdnet-calibrate"
        elif changes[best] < -_LEAST_LOSS:
            fit = Fit.BEST_AS_GIVEN
            text = f"the returns fit better as given than turned by {_TURN_DEGREES:g} degree"
        else:
            fit = Fit.NOT_VISIBLE
            text = (
                "the first frames do not show whether it is right to a degree: run ssdnet-calibrate"
            )
        return QuickFinding(
            fit, len(unturned), float(np.median(unturned)), turned, f"calibration: {text}"
        )
