"""Time stamps of sensors: seconds as a float or nanoseconds as an int, of any clock."""

import math
import operator
from typing import Any

import numpy as np

from runtime.checks import shown
from runtime.errors import InputError

Stamp = float | int

NS_PER_MS = 1_000_000
#: Largest difference between the stamps of an image and its depth map by default: half the period
#: of a LiDAR of 10 Hz, so that each scan has its image.
DEFAULT_MAX_SKEW_MS = 50.0
#: Oldest depth that an image without depth of its own takes: a LiDAR of 10 Hz may lose a scan.
DEFAULT_REUSE_DEPTH_MS = 150.0
#: The clock of a sensor was reset if its stamps go back further.
JUMP_BACK_NS = 1_000 * NS_PER_MS
_COARSEST_S = 1e-3  # of the time since 1970, float64 resolves 2.4e-7 s, float32 128 s
_LIMIT_NS = 2**63  # what 64 bits hold: 292 years


def stamp_ns(stamp: Any) -> int:
    """Return a stamp in nanoseconds.

    Args:
        stamp: seconds if a float, nanoseconds if an int; Python's or NumPy's.

    Raises:
        InputError: if it is of another type, not finite, beyond 64 bits of nanoseconds, or a float
            that is too short to tell milliseconds apart.
    """
    if isinstance(stamp, float | np.floating):
        nanoseconds_float = float(stamp) * 1e9
        nanoseconds = round(nanoseconds_float) if math.isfinite(nanoseconds_float) else _LIMIT_NS
    elif isinstance(stamp, bool | np.bool_):
        raise InputError(f"stamp must be seconds (float) or nanoseconds (int), got {stamp}")
    else:
        try:
            nanoseconds = operator.index(stamp)
        except TypeError:
            raise InputError(
                "stamp must be seconds (float) or nanoseconds (int), got "
                f"{type(stamp).__name__}: give the sensor's own stamp, of any clock"
            ) from None
    if not -_LIMIT_NS <= nanoseconds < _LIMIT_NS:
        raise InputError(
            f"stamp must be finite and fit in 64 bits of nanoseconds, got {shown(stamp)}: "
            "a float is seconds, an int nanoseconds"
        )
    if isinstance(stamp, np.floating) and (step_s := float(np.spacing(abs(stamp)))) > _COARSEST_S:
        raise InputError(
            f"stamp must resolve milliseconds, got {shown(stamp)} in {stamp.dtype}, whose next "
            f"value is {step_s:g} s away: give float64 seconds, or nanoseconds"
        )
    return nanoseconds
