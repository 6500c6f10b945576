"""A short soak with every kind of fault."""

import pytest

from runtime import Predictor
from soak import resized_frames, soak


@pytest.fixture(scope="module")
def soaked():
    frames = resized_frames((64, 96))
    with Predictor(threads=1) as predictor:
        return soak(predictor, frames, period_s=0, go_on=lambda number: number < 600)


def test_every_message_is_accounted_for(soaked):
    assert soaked.problems() == []
    assert soaked.counts.pushed == soaked.called.total() > 1000
    assert soaked.results == soaked.counts.images.answered > 0
    assert soaked.statistics.stages["latency"].n >= soaked.results


def test_every_kind_of_fault_was_injected_and_found(soaked):
    assert len(soaked.faults) == 14
    assert {"bad_stamp", "bad_message"} <= soaked.counts.errors.keys()
    assert {"overtaken", "duplicate"} <= soaked.counts.dropped.keys()
    assert soaked.counts.jumps_back > 0
