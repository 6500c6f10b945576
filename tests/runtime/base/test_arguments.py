"""Checks of numbers: of any library, within their range, and shown short in an error."""

import math

import numpy as np
import pytest

from runtime import InputError
from runtime.base.arguments import check_integer, check_number, shown


@pytest.mark.parametrize("value", [1, np.int64(10), np.uint8(3)])
def test_a_number_of_any_library(value):
    for check, kind in ((check_number, float), (check_integer, int)):
        found = check("n", value, 1, 10)
        assert (type(found), found) == (kind, value)
    assert check_number("n", np.float32(1.5), 1, 10) == 1.5


@pytest.mark.parametrize("value", [0, 0.9, 10.1, math.nan, math.inf, True, "3", None, [3], 1j])
def test_what_is_no_number_in_its_range(value):
    with pytest.raises(InputError, match="1 to 10 metres"):
        check_number("n", value, 1, 10, "metres", error=InputError)
    with pytest.raises(ValueError, match="1 to 10"):
        check_integer("n", value, 1, 10)


def test_a_long_value_is_cut():
    assert shown("short") == "'short'"
    assert shown("x" * 1000, 20) == "'" + "x" * 19 + "…"
