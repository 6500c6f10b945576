"""The names of files: their normal form, the numbers in them, and their order by these numbers.

All code that lists files uses this module, so that every list has the same order.
"""

import re
import unicodedata
from collections.abc import Iterable
from decimal import Decimal

# A decimal number has one point between two digits, as in 1700000000.05. A number that is the whole
# name may also be negative, or have an exponent, as in 5e-05.
_DECIMAL = r"(?<![0-9.])[0-9]+\.[0-9]+(?![0-9.])"
_NUMBERS = re.compile(
    rf"(^-?[0-9]+(?:\.[0-9]+)?e-[0-9]+$|^-[0-9]+(?:\.[0-9]+)?$|{_DECIMAL}|[0-9]+)"
)
_WHOLE = re.compile("([0-9]+)")
_CLOCK_DIGITS = 9  # of seconds since 1970


def normal_form(name: str) -> str:
    """Return a name in the form NFC, since macOS decomposes accented letters, and others do not."""
    return unicodedata.normalize("NFC", name)


def in_natural_order(names: Iterable[str]) -> list[str]:
    """Sort names by the numbers in them: "9" comes before "10", and "12.25" before "12.5"."""
    names = list(names)
    numbers = _pattern(names)

    def key(name: str) -> tuple[list[str | Decimal], str]:
        parts = numbers.split(name)  # text at even places, numbers at odd ones
        return [Decimal(part) if index % 2 else part for index, part in enumerate(parts)], name

    return sorted(names, key=key)


def numbers_in(names: Iterable[str]) -> dict[str, tuple[Decimal, ...]]:
    """Return the numbers in each name: (0.5,) for "image_0.50", and (3, 7) for "3_07"."""
    names = list(names)
    numbers = _pattern(names)
    return {name: tuple(map(Decimal, numbers.findall(name))) for name in names}


def contain_decimals(names: Iterable[str]) -> bool | None:
    """Return whether numbers with a point in these names are decimals; None if it is not clear.

    They are decimals if the digits before the point are seconds since 1970. They are also decimals
    if the digits after the point have several lengths and some begin with 0, as in 0.05 and 0.1.
    They are two counters if the lengths differ and some end in 0, as in 1.9 and 1.10, because no
    program writes decimals in this way.
    """
    decimals = {part for name in names for part in re.findall(_DECIMAL, name)}
    split = [part.split(".") for part in decimals]
    wholes, parts = zip(*split, strict=True) if split else ((), ())
    if any(len(whole) >= _CLOCK_DIGITS for whole in wholes):
        return True
    if len(set(map(len, parts))) < 2:
        return None
    if any(part.startswith("0") and len(part) > 1 for part in parts):
        return True
    return False if any(part.endswith("0") and len(part) > 1 for part in parts) else None


def _pattern(names: list[str]) -> re.Pattern[str]:
    return _WHOLE if contain_decimals(names) is False else _NUMBERS
