"""Files with one time stamp per line."""

from pathlib import Path

from runtime.base.errors import InputError
from runtime.base.stamp import parse_date, parse_seconds
from runtime.files.read_input import read_text


def read_timestamps(path: Path) -> list[int]:
    """Read a file with rising times, one per line: seconds, or dates as in KITTI's raw data.

    Returns:
        The times in nanoseconds.

    Raises:
        InputError: if the file cannot be read, if a line is not a time, or if a time is not later
            than the one before.
    """
    stamps_ns: list[int] = []
    for number, line in enumerate(read_text(path).rstrip().splitlines(), 1):
        where = f"line {number} of {path}"
        stamps_ns.append((parse_date if ":" in line else parse_seconds)(line, where))
        if number > 1 and stamps_ns[-1] <= stamps_ns[-2]:
            raise InputError(f"{where} is {line!r:.60}, expected a later time than the line before")
    return stamps_ns
