"""What can be wrong with a LiDAR."""

from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Depth = NDArray[np.float32]
Fault = Literal["none", "nan", "shift", "dropout"]

#: Share of the measurements that the fault "nan" makes NaN, infinite or negative.
NAN_SHARE = 0.3
#: How far the fault "shift" moves the whole scan: right and down [share of the width].
SHIFT = (0.01, 0.004)
#: Share of the width, in the middle, whose measurements the fault "dropout" takes away.
DROPOUT_SHARE = 1 / 3


def add_fault(fed: Depth, fault: Fault, rng: Generator) -> Depth:
    """Return a damaged copy of a sparse depth map float32 (H, W) [m], 0 = none.

    "nan": `NAN_SHARE` of the measurements are NaN, infinite or negative, a third each. "shift":
    the scan lies `SHIFT` beside its place, as after a knock on the sensor. "dropout": the middle
    `DROPOUT_SHARE` of the picture has no measurement. "none": nothing is wrong.
    """
    damaged = fed.copy()
    width = fed.shape[1]
    if fault == "nan":
        row, column = np.nonzero(fed)
        hit = rng.random(len(row)) < NAN_SHARE
        nonsense = np.array([np.nan, np.inf, -1.0], dtype=np.float32)
        damaged[row[hit], column[hit]] = nonsense[rng.integers(0, 3, int(hit.sum()))]
    elif fault == "shift":
        across, down = (max(1, round(part * width)) for part in SHIFT)
        damaged = np.zeros_like(fed)
        damaged[down:, across:] = fed[:-down, :-across]
    elif fault == "dropout":
        start = round((1 - DROPOUT_SHARE) / 2 * width)
        damaged[:, start : width - start] = 0
    return damaged
