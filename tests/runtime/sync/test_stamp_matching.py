"""Recorded messages matched by their stamps."""

from collections import Counter

import pytest

from runtime import InputError
from runtime.sources.recorded_motion import left_out_note
from runtime.sync.matching import Message
from runtime.sync.outcome import Sensor
from runtime.sync.stamp_matching import match_by_stamp

MS = 1_000_000


def match(messages, **options):
    """[(image stamp, depth stamp or None)] in ms, and what was left out."""
    left_out = Counter()
    options = {"max_skew_ms": 20, "reuse_depth_ms": 0, "waiting": 64, **options}

    def count(decided):
        left_out.update(f"{gone.sensor}: {gone.outcome}" for gone in decided.discarded)

    stamped = [(Sensor(sensor), Message(stamp, stamp * MS)) for sensor, stamp in messages]
    pairs = list(match_by_stamp(stamped, on_decided=count, **options))
    stamps = [(p.image.stamp_ns // MS, p.depth and p.depth.stamp_ns // MS) for p in pairs]
    return stamps, dict(left_out)


def test_the_nearest_within_the_skew_belong_together():
    messages = [("image", 0), ("depth", 12), ("image", 33), ("image", 67), ("depth", 112)]
    messages += [("image", 100), ("depth", 400)]
    stamps, left_out = match(messages)
    assert stamps == [(0, 12), (33, None), (67, None), (100, 112)]
    assert left_out == {"depth: no_image": 1}


def test_a_sensor_that_was_recorded_late_still_finds_its_partners():
    images = [("image", 100 * i) for i in range(40)]
    depths = [("depth", 100 * i + 5) for i in range(40)]
    stamps, left_out = match(images + depths)
    assert stamps == [(100 * i, 100 * i + 5) for i in range(40)]
    assert left_out == {}


@pytest.mark.parametrize("order", [1, -1])
def test_a_silent_sensor_does_not_block(order):
    messages = (
        [("image", 100 * i) for i in range(1000)],
        [("depth", 500_000 + i) for i in range(600)],
    )
    stamps, left_out = match([m for part in messages[::order] for m in part])
    assert stamps == [(100 * i, None) for i in range(1000)]
    assert left_out == {"depth: no_image": 600}


def test_duplicates_and_late_images_are_left_out_and_counted():
    messages = [("image", 0), ("image", 0), ("depth", 0), ("image", 300), ("depth", 300)]
    messages += [("image", 600), ("depth", 600), ("depth", 600), ("image", 250)]
    stamps, left_out = match(messages)
    assert stamps == [(0, 0), (300, 300), (600, 600)]
    assert left_out == {"image: duplicate": 1, "depth: duplicate": 1, "image: late": 1}
    assert left_out_note(Counter(left_out)) == (
        "left out: depth: duplicate 1, image: duplicate 1, image: late 1",
    )
    assert left_out_note(Counter()) == ()


def test_stamps_that_start_again_are_matched_again():
    messages = [(sensor, t) for t in (9000, 9100, 0, 100) for sensor in ("image", "depth")]
    stamps, _ = match(messages)
    assert stamps == [(9000, 9000), (9100, 9100), (0, 0), (100, 100)]


@pytest.mark.parametrize("skew", [-1, float("nan"), 1e9])
def test_an_invalid_skew(skew):
    with pytest.raises(InputError, match="max_skew_ms"):
        match([], max_skew_ms=skew)
