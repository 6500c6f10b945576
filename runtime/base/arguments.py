"""Checks of numbers and arrays from callers and files, and the text by which an error shows them.

This module imports no other module of the project.
"""

import numbers
import operator
from typing import Any

import numpy as np


def shown(value: object, most: int = 80) -> str:
    """Return the repr of a value for an error message, cut after `most` characters."""
    return cut(repr(value), most)


def cut(text: str, most: int = 80) -> str:
    """Return a text for an error message, cut after `most` characters."""
    return text if len(text) <= most else f"{text[:most]}…"


def check_number(
    name: str,
    value: Any,
    least: float,
    most: float,
    unit: str = "",
    *,
    error: type[Exception] = ValueError,
) -> float:
    """Return any real number between `least` and `most` as a float.

    Numbers of Python, NumPy and other libraries are accepted, booleans are not. For anything else
    `error` is raised, with the name of the number.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not (is_number and least <= value <= most):
        raise error(f"{name} must be {least:g} to {most:g}{unit and ' '}{unit}, got {shown(value)}")
    return float(value)


def check_integer(
    name: str,
    value: Any,
    least: int,
    most: int = 2**31 - 1,
    unit: str = "",
    *,
    error: type[Exception] = ValueError,
) -> int:
    """Return any whole number between `least` and `most` as an int; errors as in `check_number`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if isinstance(value, bool) or not least <= number <= most:
        raise error(
            f"{name} must be a whole number of {least} to {most}{unit and ' '}{unit}, got "
            f"{shown(value)}"
        )
    return number


def array_dtype(array: Any) -> Any:
    """Return the dtype of a plain NumPy array, or the name of any other type."""
    if isinstance(array, np.ndarray) and not isinstance(array, np.ma.MaskedArray | np.matrix):
        return array.dtype
    return type(array).__name__
