"""The rule for the size at which a network runs, and the sizes that are refused."""

import numpy as np
import pytest

from runtime import InputError
from runtime.contract.network_size import check_network_size, network_size, parse_network_size


@pytest.mark.parametrize(("asked", "frame", "trained", "expected"), [
    # None: the trained height, where the frame is larger by more than a quarter.
    (None, (1216, 1936), 400, (400, 637)),
    (None, (900, 1600), 400, (400, 711)),
    (None, (501, 1000), 400, (400, 798)),
    (None, (500, 1000), 400, (500, 1000)),
    (None, (375, 1242), 400, (375, 1242)),
    (None, (1216, 1936), None, (1216, 1936)),
    (None, (2000, 40), 400, (400, 32)),
    ("frame", (1216, 1936), 400, (1216, 1936)),
    # Rows, up and down; (height, width) exactly.
    (400, (200, 300), None, (400, 600)),
    ((256, 832), (1216, 1936), 400, (256, 832)),
])  # fmt: skip
def test_the_rule(asked, frame, trained, expected):
    asked = check_network_size(asked, fixed=False)
    assert network_size(asked, frame, trained_height=trained) == expected


@pytest.mark.parametrize("asked", [
    True, 31, 16_385, 400.0, "400", b"frame", (400, 31), (400.0, 640), (16_384, 16_384),
    (64, 64, 64), np.zeros(2, int),
], ids=str)  # fmt: skip
def test_nonsense_is_refused(asked):
    with pytest.raises(InputError, match="size"):
        check_network_size(asked, fixed=False)


@pytest.mark.parametrize("asked", ["frame", 400, (48, 64), True])
def test_a_model_of_fixed_size_takes_none_but_its_own(asked):
    assert check_network_size(None, fixed=True) is None
    with pytest.raises(InputError, match="fixed"):
        check_network_size(asked, fixed=True)


def test_rows_that_a_long_frame_makes_too_wide_are_refused():
    with pytest.raises(InputError, match="4000 x 1200000"):
        network_size(4000, (40, 12_000), trained_height=None)
    with pytest.raises(InputError, match="at most"):
        network_size(16_000, (400, 400), trained_height=None)


def test_words_of_the_command_line():
    assert parse_network_size("auto") is None
    assert parse_network_size("frame") == "frame"
    assert parse_network_size("400") == 400
    assert parse_network_size("400x640") == (400, 640)
    for text in ("", "x", "400x", "x640", "-400", "4e2", "400x640x3", "31", "1" * 5000, "four"):
        # In the words that can be typed.
        with pytest.raises(InputError, match=f"`size=` {text[:9]!r:.9}"):
            parse_network_size(text)
