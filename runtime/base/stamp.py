"""Time stamps of sensors, as numbers and as text. They may come from any clock."""

import operator
import warnings
from decimal import Decimal
from typing import Any

import numpy as np

from runtime.base.arguments import shown
from runtime.base.errors import InputError

# Seconds as a float or nanoseconds as an int.
Stamp = float | int

NS_PER_MS = 1_000_000
# Default of the largest difference between the stamps of an image and its depth map. It is half
# the period of a LiDAR of 10 Hz, so that each scan has its image.
DEFAULT_MAX_SKEW_MS = 50.0
# Default of the largest age of depth that is reused for an image without depth of its own. A LiDAR
# of 10 Hz may lose one scan.
DEFAULT_REUSE_DEPTH_MS = 150.0
# If the stamps of a sensor go back by more than this, its clock was reset.
JUMP_BACK_NS = 1_000 * NS_PER_MS
_COARSEST_S = 1e-3  # float64 resolves the time since 1970 to 2.4e-7 s, float32 to 128 s
_DATE = "2011-09-26 13:02:25.964389445"
_LIMIT_NS = 2**63  # 64 bits hold 292 years


def stamp_ns(stamp: Any) -> int:
    """Return a stamp in nanoseconds.

    Args:
        stamp: a float in seconds or an int in nanoseconds, of Python or NumPy.

    Raises:
        InputError: if the stamp has another type, is not finite, exceeds 64 bits of nanoseconds, or
            is a float of too few bits to resolve milliseconds.
    """
    try:
        if isinstance(stamp, bool | np.bool_):
            raise TypeError
        is_float = isinstance(stamp, float | np.floating)
        nanoseconds = round(float(stamp) * 1e9) if is_float else operator.index(stamp)
    except (OverflowError, TypeError, ValueError):  # Inf, another type, NaN
        nanoseconds = _LIMIT_NS
    if not -_LIMIT_NS <= nanoseconds < _LIMIT_NS:
        raise InputError(
            "stamp must be seconds (float) or nanoseconds (int), finite and within 64 bits of "
            f"nanoseconds, got {shown(stamp)}: give the sensor's own stamp, of any clock"
        )
    if isinstance(stamp, np.floating) and (step_s := float(np.spacing(abs(stamp)))) > _COARSEST_S:
        raise InputError(
            f"stamp must resolve milliseconds, got {shown(stamp)} in {stamp.dtype}, whose next "
            f"value is {step_s:g} s away: give float64 seconds, or nanoseconds"
        )
    return nanoseconds


def parse_date(text: str, where: str) -> int:
    """Return the nanoseconds since 1970 of a date and time such as `_DATE`, in UTC.

    Raises:
        InputError: if the text is no date and time; the message begins with `where`.
    """
    try:
        with warnings.catch_warnings(action="error"):  # NumPy warns about a time zone
            date: np.datetime64 = np.datetime64(text.strip(), "ns")
    except (ValueError, UserWarning):
        date = np.datetime64("NaT")
    if np.isnat(date):  # an empty line is also NaT
        raise InputError(f"{where} is {text!r:.60}, expected a time like {_DATE}")
    return int(date.astype(np.int64))


def parse_seconds(text: str, where: str) -> int:
    """Return seconds in nanoseconds, exact to the last digit; errors as in `parse_date`."""
    try:
        stamp_ns = Decimal(text.strip()) * 10**9
        if abs(stamp_ns) < 2**63:
            return int(stamp_ns)
    except ArithmeticError:  # no number, or a NaN
        pass
    raise InputError(f"{where} is {text!r:.60}, expected seconds, or a time like {_DATE}")
