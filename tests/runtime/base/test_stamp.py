import numpy as np
import pytest

from runtime.base.errors import InputError
from runtime.base.stamp import stamp_ns
from runtime.recordings.poses import read_timestamps


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


@pytest.mark.parametrize(("text", "stamps_ns"), [
    ("0.104\n1600000000.123456789\n", [104_000_000, 1600000000123456789]),
    ("0.000000e+00\n1.038957e-01\n", [0, 103_895_700]),
    ("-1.5\n-0.25\n", [-1_500_000_000, -250_000_000]),
    ("1970-01-01 00:00:01.000000001\n1970-01-01 00:00:02\n", [1_000_000_001, 2_000_000_000]),
])  # fmt: skip
def test_seconds_and_dates_are_exact(tmp_path, text, stamps_ns):
    (tmp_path / "times.txt").write_text(text)
    assert read_timestamps(tmp_path / "times.txt") == stamps_ns


@pytest.mark.parametrize("line", ["noon", "nan", "inf", "1e30", "2011-13-01 00:00:00", ""])
def test_a_line_that_is_no_time_is_named(tmp_path, line):
    (tmp_path / "times.txt").write_text(f"0.5\n{line}\n9\n")
    with pytest.raises(InputError, match=r"line 2 of .*times\.txt"):
        read_timestamps(tmp_path / "times.txt")
