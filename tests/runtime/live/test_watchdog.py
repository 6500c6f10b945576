from types import SimpleNamespace

import pytest

from runtime.errors import InputError
from runtime.live.watchdog import Level, Watchdog, WatchdogLimits

MS = 1_000_000


def answered(watchdog, at_ms=0, *, late=False, degraded=(), health=(), valid=True):
    result = SimpleNamespace(
        deadline_met=not late,
        health=health,
        depth_reused="depth_reused" in degraded,
        prediction=SimpleNamespace(degraded=degraded, valid=valid),
    )
    watchdog.answered(result, at_ms * MS)


def levels(watchdog, at_ms=0):
    state = watchdog.state(at_ms * MS)
    return state.level.value, state.reasons


def test_not_available_before_the_first_message():
    watchdog = Watchdog(WatchdogLimits())
    assert levels(watchdog, 10**6) == ("n/a", ())
    watchdog.start(0)
    assert levels(watchdog) == ("OK", ())


@pytest.mark.parametrize(
    ("wrong", "limits"),
    [
        ({"late": True}, {"late": (2, 4)}),
        ({"degraded": ("no_depth",)}, {"degraded": (2, 4)}),
        ({"health": ("image_frozen",)}, {"degraded": (2, 4)}),
        ({"degraded": ("depth_reused",)}, {"reused": (2, 4)}),
        ({"valid": False}, {"failed": (2, 4)}),
    ],
)
def test_runs_warn_then_are_an_error_and_end(wrong, limits):
    watchdog = Watchdog(WatchdogLimits(**limits))
    (reason,) = limits
    expected = ["OK", "WARN", "WARN", "ERROR", "ERROR"]
    for level in expected:
        answered(watchdog, **wrong)
        assert levels(watchdog) == (level, () if level == "OK" else (reason,))
    answered(watchdog)
    assert levels(watchdog) == ("OK", ())


def test_frames_that_were_errors_count_as_failed():
    watchdog = Watchdog(WatchdogLimits(failed=(1, 2)))
    watchdog.start(0)
    watchdog.failed()
    assert levels(watchdog) == ("WARN", ("failed",))
    watchdog.failed()
    assert levels(watchdog) == ("ERROR", ("failed",))


def test_silence_is_reported_by_the_clock_and_ends_with_a_result():
    watchdog = Watchdog(WatchdogLimits(silence_ms=(500, 2000)))
    watchdog.start(0)
    watchdog.start(400 * MS)  # only the first message counts
    assert watchdog.due_ns(0) == 500 * MS
    assert levels(watchdog, 499) == ("OK", ())
    assert levels(watchdog, 500) == ("WARN", ("silence_ms",))
    assert watchdog.due_ns(500 * MS) == 2000 * MS
    assert levels(watchdog, 2000) == ("ERROR", ("silence_ms",))
    assert watchdog.due_ns(2000 * MS) is None
    answered(watchdog, 2100)
    assert levels(watchdog, 2100) == ("OK", ())


def test_the_worst_counts_and_none_is_never():
    watchdog = Watchdog(WatchdogLimits(late=(1, 1), degraded=(1, None)))
    for _ in range(100):
        answered(watchdog, degraded=("no_depth",))
    assert watchdog.state(0).level is Level.WARN
    answered(watchdog, late=True, degraded=("no_depth",))
    assert levels(watchdog) == ("ERROR", ("late", "degraded"))


@pytest.mark.parametrize("pair", [None, (1,), (0, 2), (1, True), ("1", 2), [1, 2], (-1, None)])
def test_invalid_limits(pair):
    with pytest.raises(InputError, match="late must be a pair"):
        WatchdogLimits(late=pair)
