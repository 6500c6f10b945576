"""Two clocks, and times of points and scans that are assumed."""

from contextlib import nullcontext

import numpy as np
import pytest

from runtime import Rig
from runtime.checks.sensor_times import clocks_apart_s
from runtime.geometry.assumptions import collect_assumptions
from runtime.streams.messages import Depth, Image, Scan
from runtime.streams.sensor_input import SensorInput
from runtime.streams.stream_counter import StreamCounter

S, PERIOD = 10**9, 10**8


def apart(ahead_s, *, is_scan=True):
    images, scans = [-5_000_000] * 9, [-6_000_000 + round(ahead_s * S)] * 9
    return clocks_apart_s(images, scans, PERIOD, is_scan=is_scan)


@pytest.mark.parametrize("ahead_s", [1.0, 37.0, 0.06, -0.3, -37.0])
def test_two_clocks_are_found(ahead_s):
    assert apart(ahead_s) == pytest.approx(ahead_s, abs=0.002)


def test_a_clock_that_is_set_during_the_recording_is_found():
    scans = [0] * 24 + [80_000_000] * 16
    assert clocks_apart_s([0] * 40, scans, PERIOD, is_scan=True) == pytest.approx(0.08)


def test_the_time_that_drivers_take_is_no_other_clock():
    assert apart(0.04) is None
    assert apart(-0.14) is None, "recorded when a scan ends, stamped at its start"
    assert apart(-0.14, is_scan=False) is not None, "a depth map has no duration"
    assert clocks_apart_s([0], [S], PERIOD, is_scan=True) is None


@pytest.mark.parametrize(
    ("ahead_s", "late", "is_said"), [(1.0, 0, True), (0.0, 0, False), (0.0, 10, False)]
)
def test_the_clocks_of_a_live_stream_are_compared_by_arrival(ahead_s, late, is_said):
    """The stamps began long ago; the first images may arrive late together."""
    counter, notes = StreamCounter(), []
    sensors = SensorInput(Rig(), counter=counter, lock=nullcontext())
    with collect_assumptions(notes):
        for number in range(40):
            now = S + number * PERIOD
            late_ns = 3 * PERIOD if number < late else 0
            sensors.take(Image(None, stamp_ns=now - 70 * S, arrived_ns=now + late_ns))
            stamp_ns = now - 70 * S + round(ahead_s * S)
            sensors.take(Depth(None, stamp_ns=stamp_ns, arrived_ns=now))
    assert len(notes) == is_said
    assert all("1 s ahead of that of the images" in note for note in notes)


@pytest.mark.parametrize(("first", "last", "is_said"), [
    (0.0, 0.1, False), (-0.1, 0.0, False), (-0.05, 0.05, False), (-0.15, -0.05, False),
    (0.0, 0.5, False), (-0.301, -0.299, True), (0.4, 0.5, True),
])  # fmt: skip
def test_times_of_points_far_from_their_stamp_are_said(first, last, is_said):
    points = np.full((500, 3), 5, np.float32)
    notes = []
    with collect_assumptions(notes):
        Scan.of(points, np.linspace(first, last, 500), S)
    assert bool(notes) == is_said
    assert all("of another clock" in note for note in notes)
