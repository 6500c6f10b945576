"""Files with a time a line, as of the frames of a recording."""

import warnings
from decimal import Decimal
from pathlib import Path

import numpy as np

from runtime.errors import InputError
from runtime.read_input import read_text

_DATE = "2011-09-26 13:02:25.964389445"


def read_timestamps(path: Path) -> list[int]:
    """Read a file with a time a line, seconds or a date as of KITTI's raw data, rising.

    Returns:
        Nanoseconds.

    Raises:
        InputError: if the file cannot be read, a line is no time, or a time is not later than the
            one before.
    """
    stamps_ns: list[int] = []
    for number, line in enumerate(read_text(path).rstrip().splitlines(), 1):
        where = f"line {number} of {path}"
        stamps_ns.append((parse_date if ":" in line else parse_seconds)(line, where))
        if number > 1 and stamps_ns[-1] <= stamps_ns[-2]:
            raise InputError(f"{where} is {line!r:.60}, expected a later time than the line before")
    return stamps_ns


def parse_date(text: str, where: str) -> int:
    """Nanoseconds since 1970 of a date and time such as `_DATE`, taken as UTC.

    Raises:
        InputError: if it is none; it begins with `where`.
    """
    try:
        with warnings.catch_warnings(action="error"):  # of a time zone
            date: np.datetime64 = np.datetime64(text.strip(), "ns")
    except (ValueError, UserWarning):
        date = np.datetime64("NaT")
    if np.isnat(date):  # also of an empty line
        raise InputError(f"{where} is {text!r:.60}, expected a time like {_DATE}")
    return int(date.astype(np.int64))


def parse_seconds(text: str, where: str) -> int:
    """Nanoseconds of a number of seconds, exact to the last digit; errors as `parse_date`."""
    try:
        stamp_ns = Decimal(text.strip()) * 10**9
        if abs(stamp_ns) < 2**63:
            return int(stamp_ns)
    except ArithmeticError:  # no number, or a NaN
        pass
    raise InputError(f"{where} is {text!r:.60}, expected seconds, or a time like {_DATE}")
