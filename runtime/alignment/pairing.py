"""Whether images are paired with their own scans: a neighbouring scan must not fit them better."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from runtime.alignment.fit_scores import total_scores
from runtime.alignment.search import find_coarse
from runtime.alignment.view import View

_LEAST_FRAMES, _MOST_FRAMES = 3, 10
_LEAST_GAIN, _ERRORS = 0.02, 2.0  # of the sum of both figures, and in its standard errors


def find_pairing_fault(views: Sequence[View], angles: NDArray[np.float64]) -> str | None:
    """Return why the scans seem to belong to other images; None if they seem to be the images' own.

    Args:
        views: views of the frames, in order.
        angles: the rotation at which the frames' own scans fit best, see `find_coarse`. Each
            neighbouring scan is turned to where it fits best, too.
    """
    step = -(-len(views) // _MOST_FRAMES)
    for beside, word in enumerate(("before", "after")):
        pairs = [
            (view, view.with_scan(points))
            for view in views[::step]
            if (points := view.neighbours[beside]) is not None
        ]
        pairs = [(own, other) for own, other in pairs if other.has_structure]
        if len(pairs) < _LEAST_FRAMES:
            continue
        own, other = (list(each) for each in zip(*pairs, strict=True))
        of_own, of_other = total_scores(own, angles), total_scores(other, find_coarse(other))
        gains = of_other - of_own
        error = gains.std(ddof=1) / np.sqrt(len(gains))
        if gains.mean() > max(_LEAST_GAIN, _ERRORS * error):
            return (
                f"the scans of the frames {word} fit the images better than their own "
                f"({of_other.mean():.2f} instead of {of_own.mean():.2f}): check the time stamps, "
                "or the names of the files"
            )
    return None
