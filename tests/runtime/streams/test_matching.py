"""Matching live and of recordings: by hand, against a plain loop, invariants of any sequence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.geometry.rig import Rig
from runtime.streams.matching import LiveMatcher, RecordingMatcher
from runtime.streams.messages import Depth, Image, Outcome, Sensor

MS = 1_000_000
IMAGE, DEPTH = Sensor.IMAGE, Sensor.DEPTH
CAPACITY = 16


class Played:
    """Plays messages to a matching and keeps what it decides; all times in ms.

    A recording waits by the stamps, for 50 ms.
    """

    def __init__(self, *, live, max_skew=20, max_wait=50, capacity=CAPACITY, reuse=0):
        options = Rig(max_skew_ms=max_skew, reuse_depth_ms=reuse), capacity
        self.matching = LiveMatcher(*options, max_wait) if live else RecordingMatcher(*options)
        self.live, self.now, self.jumps_back = live, 0, 0
        self.pushed, self.pairs, self.discarded = [], [], []

    def push(self, sensor, stamp, *, at=None):
        self.now = self.now if at is None else at
        kind, arrived_ns = Image if sensor is IMAGE else Depth, round(self.now * MS)
        message = kind(None, stamp_ns=round(stamp * MS), given=stamp, arrived_ns=arrived_ns)
        self.pushed.append(message)
        return self._keep(self.matching.add(message))

    def image(self, stamp, **options):
        return self.push(IMAGE, stamp, **options)

    def depth(self, stamp, **options):
        return self.push(DEPTH, stamp, **options)

    def advance(self, now):
        self.now = now
        return self._keep(self.matching.advance(round(now * MS))) if self.live else []

    def flush(self):
        return self._keep(self.matching.flush())

    def _keep(self, decided):
        self.pairs += decided.pairs
        self.discarded += decided.discarded
        self.jumps_back += decided.jumped_back
        return stamps(decided.pairs)

    def outcomes(self):
        return [(gone.sensor, gone.stamp, outcome) for gone, outcome in self.discarded]


def stamps(pairs):
    return [(pair.image.stamp, pair.depth and pair.depth.stamp) for pair in pairs]


@pytest.mark.parametrize("live", [True, False], ids=["live", "recorded"])
def test_the_nearest_wins_also_when_it_is_last(live):
    played = Played(live=live)
    played.depth(0)
    assert played.image(18) == [], "18 ms apart: a nearer one may come"
    found = played.depth(30)
    found += played.image(100)
    assert found[0] == (18, 30)


def test_regular_live_sensors_do_not_wait_for_their_next_message():
    played = Played(live=True)
    for stamp in (0, 100, 200):
        played.depth(stamp, at=stamp)
        played.image(stamp + 7, at=stamp + 8)
        played.advance(stamp + 99)
    assert played.depth(300, at=300) == []
    assert played.image(307, at=308) == [(307, 300)], "the next depth map comes at 400"


def test_live_an_image_waits_for_max_wait_by_the_clock_and_no_longer():
    played = Played(live=True)
    played.image(0, at=5)
    assert played.matching.due_ns() == 55 * MS
    assert played.advance(54.9) == []
    assert played.advance(55) == [(0, None)]
    played.depth(0, at=56)
    played.advance(200)
    assert played.outcomes() == [(DEPTH, 0, Outcome.NO_IMAGE)]


def test_recorded_an_image_waits_by_the_stamps_of_the_other_sensor():
    played = Played(live=False)
    played.image(0)
    assert played.depth(70) == []
    assert played.depth(71) == [(0, None)], "skew and wait are over by the stamps"


@pytest.mark.parametrize("live", [True, False], ids=["live", "recorded"])
def test_duplicates_and_late_images_are_discarded(live):
    played = Played(live=live)
    played.image(100)
    played.image(100)
    played.depth(100)
    played.depth(100)
    played.image(90)
    assert stamps(played.pairs) == [(100, 100)]
    assert played.outcomes() == [
        (IMAGE, 100, Outcome.DUPLICATE),
        (DEPTH, 100, Outcome.DUPLICATE),
        (IMAGE, 90, Outcome.LATE),
    ]


@pytest.mark.parametrize("live", [True, False], ids=["live", "recorded"])
def test_after_a_jump_back_the_stream_goes_on(live):
    played = Played(live=live)
    for start in (5000, 0):
        for stamp in (start, start + 100):
            played.image(stamp, at=played.now + 100)
            played.depth(stamp)
    assert stamps(played.pairs) == [(5000, 5000), (5100, 5100), (0, 0), (100, 100)]
    assert played.jumps_back == 2 - 1, "the depth's stamps were forgotten with it"


def test_live_memory_is_bounded_by_dropping_the_oldest():
    played = Played(live=True, capacity=3)
    for stamp in range(5):
        played.image(stamp * 1000)
        played.depth(stamp * 1000 + 500)
    dropped = (IMAGE, 0), (DEPTH, 500), (IMAGE, 1000), (DEPTH, 1500)
    assert played.outcomes() == [(*each, Outcome.OVERFLOW) for each in dropped]


# --- images without depth of their own -----------------------------------------------------------


def reused(played):
    return [(p.image.stamp, p.depth and p.depth.stamp, p.reused) for p in played.pairs]


@pytest.mark.parametrize("live", [True, False], ids=["live", "recorded"])
def test_an_image_without_depth_takes_the_newest_before_it(live):
    played = Played(live=live, reuse=150)
    for stamp in (0, 50, 100, 150, 300):
        played.image(stamp, at=stamp)
        if stamp in (0, 100):
            played.depth(stamp)
        played.advance(stamp + 50)
    played.flush()
    assert reused(played) == [
        (0, 0, False),
        (50, 0, True),
        (100, 100, False),
        (150, 100, True),
        (300, None, False),
    ], "150 ms old is young enough, 200 ms is not"
    assert played.outcomes() == []


@pytest.mark.parametrize("live", [True, False], ids=["live", "recorded"])
@pytest.mark.parametrize(("stamp", "outcome"), [(130, "reused"), (400, "no_image")])
def test_depth_without_an_image_of_its_own_is_reused_or_unmatched(live, stamp, outcome):
    played = Played(live=live, reuse=150)
    played.depth(0)
    played.advance(60)
    assert played.outcomes() == [], "an image may still take it"
    played.image(stamp, at=stamp)
    played.advance(stamp + 60)
    played.flush()
    assert played.outcomes() == [(DEPTH, 0, Outcome(outcome))]


# --- no waiting for depth that is not due --------------------------------------------------------


def rig(played, *, until, lost=()):
    """Play an image every 50 ms and a scan every 100 ms; the ms that each image waited."""
    waited = {}
    for at in range(until + 100):
        found = played.advance(at)
        if at < until and at % 100 == 0 and at not in lost:
            found += played.depth(at, at=at)
        if at < until and at % 50 == 0:
            found += played.image(at, at=at)
        waited |= {image: at - image for image, _ in found}
    return waited


def test_live_a_lost_scan_is_waited_for_and_the_next_image_is_not():
    played = Played(live=True, max_skew=50, reuse=150)
    waited = rig(played, until=1500, lost=(1000,))
    assert (waited[950], waited[1000], waited[1050], waited[1100]) == (0, 50, 0, 0)
    assert stamps(played.pairs)[-9:-7] == [(1050, 900), (1100, 1100)]


def test_live_a_lidar_that_stopped_is_not_waited_for():
    played = Played(live=True, max_skew=50, reuse=150)
    waited = rig(played, until=2000, lost=range(1000, 2000, 100))
    assert {waited[image] for image in range(1300, 2000, 50)} == {0}
    assert stamps(played.pairs)[-14] == (1300, None)


# --- against a plain loop ----------------------------------------------------------------------


def nearest_by_a_plain_loop(images, depths, *, max_skew):
    free = list(depths)
    pairs = []
    for place, image in enumerate(images):
        own = [
            depth
            for depth in free
            if abs(depth - image) <= max_skew
            and all(abs(depth - other) >= abs(depth - image) for other in images[place:])
        ]
        depth = min(own, key=lambda depth: (abs(depth - image), depth), default=None)
        if depth is not None:
            free.remove(depth)
        pairs.append((image, depth))
    return pairs


rising = st.lists(st.integers(1, 80), max_size=12).map(lambda steps: np.cumsum(steps).tolist())


@settings(max_examples=60, deadline=None)
@given(images=rising, depths=rising, turns=st.randoms(use_true_random=False))
def test_recorded_messages_match_as_a_plain_loop_in_any_order_of_the_sensors(images, depths, turns):
    played = Played(live=False)
    sensors = [IMAGE] * len(images) + [DEPTH] * len(depths)
    turns.shuffle(sensors)
    left = {IMAGE: iter(images), DEPTH: iter(depths)}
    for sensor in sensors:
        played.push(sensor, next(left[sensor]))
    played.flush()
    assert stamps(played.pairs) == nearest_by_a_plain_loop(images, depths, max_skew=20)


# --- what holds for any sequence ---------------------------------------------------------------

anything = st.lists(
    st.tuples(
        st.sampled_from([IMAGE, DEPTH]),
        st.one_of(st.integers(0, 300), st.integers(-5000, 5000), st.just(10**9)),
        st.integers(0, 60),  # ms until it arrives
    ),
    max_size=60,
)


@settings(max_examples=80, deadline=None)
@given(
    messages=anything,
    live=st.booleans(),
    capacity=st.integers(1, 5),
    reuse=st.sampled_from([0, 30, 150, 10**6]),
)
def test_every_message_of_any_sequence_is_accounted_for(messages, live, capacity, reuse):
    played = Played(live=live, capacity=capacity, reuse=reuse)
    now, jumps, epoch = 0, 0, 0
    for sensor, stamp, after in messages:
        now += after
        played.advance(now)
        if live:
            due_ns = played.matching.due_ns()
            assert due_ns is None or due_ns > now * MS, "what is due was decided"
        played.push(sensor, stamp)
        if played.jumps_back > jumps:
            jumps, epoch = played.jumps_back, len(played.pairs)
        decided_ns = [pair.image.stamp_ns for pair in played.pairs[epoch:]]
        assert decided_ns == sorted(set(decided_ns)), "images are decided in their order"
        gone = sum(2 - (pair.own_depth is None) for pair in played.pairs) + len(played.discarded)
        assert len(played.pushed) - gone <= (3 if reuse else 2) * capacity, "memory is bounded"
    played.flush()
    assert not live or played.matching.due_ns() is None
    decided = [id(m) for pair in played.pairs for m in (pair.image, pair.own_depth) if m]
    decided += [id(item.message) for item in played.discarded]
    assert sorted(decided) == sorted(map(id, played.pushed))
    served = set()
    for image, depth, is_reused in played.pairs:
        if is_reused:
            assert 0 <= image.stamp_ns - depth.stamp_ns <= reuse * MS
            served.add(depth)
        else:
            assert depth is None or abs(image.stamp_ns - depth.stamp_ns) <= 20 * MS
    for item in played.discarded:
        assert (item.outcome is Outcome.REUSED) <= (item.message in served)
        if item.outcome is Outcome.NO_IMAGE:
            assert item.message not in served
    if not live:
        lost = {outcome for sensor, _, outcome in played.outcomes() if sensor is IMAGE}
        assert lost <= {Outcome.DUPLICATE, Outcome.LATE}, "a recording loses no other image"
