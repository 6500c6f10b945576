import numpy as np
import pytest

from runtime.errors import InputError
from runtime.stamp import stamp_ns


@pytest.mark.parametrize(("stamp", "nanoseconds"), [
    (1.5, 1_500_000_000), (0.1, 100_000_000), (7, 7), (-2.0, -2_000_000_000),
    (1_700_000_000_123_456_789, 1_700_000_000_123_456_789), (np.float32(0.5), 500_000_000),
    (np.int64(12), 12),
])  # fmt: skip
def test_floats_are_seconds_and_ints_nanoseconds(stamp, nanoseconds):
    assert stamp_ns(stamp) == nanoseconds


@pytest.mark.parametrize("stamp", [
    None, True, np.datetime64("2026-01-01"), np.nan, 1e300, 2**63, np.zeros(3), np.float32(1.7e9),
])  # fmt: skip
def test_invalid_stamps_are_refused(stamp):
    with pytest.raises(InputError, match="stamp"):
        stamp_ns(stamp)
