"""A short soak with every kind of fault."""

import pytest

from runtime import Predictor
from soak import resized_frames, soak


# Faulty stamps may look like two clocks.
@pytest.mark.filterwarnings("ignore::runtime.geometry.assumptions.AssumptionWarning")
def test_every_message_is_accounted_for_and_every_fault_is_found():
    with Predictor("ssdnet-nano", threads=1) as predictor:
        frames = resized_frames((64, 96))
        soaked = soak(predictor, frames, period_s=0, go_on=lambda number: number < 600)
    assert soaked.problems() == []
    pushed = soaked.counts.pushed + soaked.counts.poses.pushed
    assert pushed == soaked.called.total() > 1000
    assert len(soaked.faults) == 14
    assert {"bad_stamp", "bad_message"} <= soaked.counts.errors.keys()
    assert {"overtaken", "duplicate"} <= soaked.counts.dropped.keys()
