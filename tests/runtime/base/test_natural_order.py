"""Numbers in names: counters, decimals, times."""

from decimal import Decimal
from random import Random

import pytest

from runtime.base.natural_order import contain_decimals, in_natural_order, numbers_in

# Names in the right order, and whether they prove their decimals.
ORDERED = {
    "counters": (["image_1", "image_2", "image_10"], None),
    "str(time.time())": ([str(1700000000 + 0.05 * i) for i in range(9)], True),
    "seconds": ([f"{0.05 * i:g}" for i in range(12)], True),
    "prefix": (["rgb-0.95", "rgb-1.0", "rgb-1.05", "rgb-1.1"], True),
    "one length": (["0.25", "0.50", "1.00", "10.25"], None),
    "tenths": (["12.25", "12.5", "12.75", "13.0"], None),
    "camera.frame": (["1.8", "1.9", "1.10", "1.11", "2.1"], False),
    "three counters": (["1.2.9", "1.2.10", "1.10.1"], None),
    "before a trigger": (["-1", "-0.5", "-0.25", "0.0", "0.25"], None),
    "as Python writes small floats": (["1e-05", "5e-05", "0.0001", "0.01"], True),
    "a point without a number before it": (["left.2", "left.10"], None),
}


@pytest.mark.parametrize("case", ORDERED)
def test_names_are_in_the_order_of_their_numbers(case):
    names, proved = ORDERED[case]
    mixed = Random(0).sample(names, len(names))
    assert in_natural_order(mixed) == names
    assert contain_decimals(mixed) is proved


def test_numbers_of_names_are_equal_however_they_are_written():
    images = numbers_in(["image_1700000000.50", "image_1700000000.05"])
    depths = numbers_in(["depth-1700000000.5", "depth-1700000000.05"])
    assert set(images.values()) == set(depths.values())
    assert numbers_in(["1.9", "01.10"]) == {"1.9": (1, 9), "01.10": (1, 10)}
    assert numbers_in(["a_0.50"]) == {"a_0.50": (Decimal("0.5"),)}
