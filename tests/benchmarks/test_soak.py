"""A short soak: every kind of fault as fast as it goes, and a judge that sees what is wrong."""

import dataclasses

import pytest

from runtime import Predictor
from soak import Soaked, bundled_frames, soak


@pytest.fixture(scope="module")
def soaked():
    frames = bundled_frames((64, 96))
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
    assert soaked.counts.out_of_order > soaked.counts.jumps_back


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: s.called.update(["image"]), "of image pushed"),
        (lambda s: setattr(s, "results", s.results + 1), "results,"),
        (lambda s: setattr(s, "refused", 10**6), "refused"),
        (lambda s: setattr(s, "resident_mb", [100, 100, 100, 165]), "grew by 65 MB"),
        (
            lambda s: setattr(
                s, "counts", dataclasses.replace(s.counts, pushed=s.counts.pushed + 1)
            ),
            "have no outcome",
        ),
    ],
)
def test_the_judge_sees_what_is_wrong(soaked, change, said):
    spoiled = Soaked(**vars(soaked))
    spoiled.called = soaked.called.copy()
    change(spoiled)
    assert any(said in problem for problem in spoiled.problems())
