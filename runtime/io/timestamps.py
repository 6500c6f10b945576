"""Files with a time a line, as of the frames of a recording."""

from datetime import UTC, datetime
from pathlib import Path

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
        stamps_ns.append(parse_date(line, where) if ":" in line else _parse_s(line, where))
        if number > 1 and stamps_ns[-1] <= stamps_ns[-2]:
            raise InputError(f"{where} is {line!r:.60}, expected a later time than the line before")
    return stamps_ns


def parse_date(text: str, where: str) -> int:
    """Nanoseconds since 1970 of a date and time such as `_DATE`, taken as UTC.

    Raises:
        InputError: if it is none; it begins with `where`.
    """
    whole, _, fraction = text.strip().partition(".")
    try:
        if not (fraction or "0").isdecimal():  # int() takes signs and underscores
            raise ValueError(fraction)
        seconds = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
        return int(seconds) * 10**9 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise InputError(f"{where} is {text!r:.60}, expected a time like {_DATE}") from error


def parse_seconds(text: str) -> int:
    """Nanoseconds of a number of seconds, not rounded where it has no exponent.

    Raises:
        ValueError: if it is none.
    """
    whole, _, fraction = text.strip().partition(".")
    digits = whole.removeprefix("-").removeprefix("+")
    if not (digits.isdecimal() and (fraction or "0").isdecimal()):
        if "_" in text:  # float() takes them
            raise ValueError(text)
        return round(float(text) * 1e9)
    rest = int(fraction[:9].ljust(9, "0"))
    return int(whole) * 10**9 + (-rest if whole.startswith("-") else rest)


def _parse_s(text: str, where: str) -> int:
    try:
        stamp_ns = parse_seconds(text)
        if abs(stamp_ns) < 2**63:
            return stamp_ns
    except (OverflowError, ValueError):
        pass
    raise InputError(f"{where} is {text!r:.60}, expected seconds, or a time like {_DATE}")
