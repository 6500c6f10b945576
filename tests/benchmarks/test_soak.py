"""A short soak with every kind of fault, and negative controls of its checks."""

import dataclasses

import pytest

import soak as soak_program
from runtime import Predictor
from soak import Soaked, resized_frames, soak, soak_signals, soak_sources


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
    assert soaked.counts.out_of_order > soaked.counts.jumps_back


@pytest.mark.parametrize(
    ("change", "message"),
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
def test_violations_are_reported(soaked, change, message):
    spoiled = Soaked(**vars(soaked))
    spoiled.called = soaked.called.copy()
    change(spoiled)
    assert any(message in problem for problem in spoiled.problems())


def test_programs_that_signals_interrupt_end_well(monkeypatch):
    assert soak_signals(rounds=1, seed=0) == []
    monkeypatch.setattr(soak_program, "_CLOSED_BY_SIGNALS", "raise SystemExit(3)")
    assert soak_signals(rounds=1, seed=7) == ["seed 7: exit code 3: "]


def test_damaged_sources_are_read_or_refused(monkeypatch):
    assert soak_sources(rounds=8, seed=0) == []
    monkeypatch.setattr(soak_program, "InputError", ZeroDivisionError)  # then no refusal is known
    found = soak_sources(rounds=8, seed=0)
    assert found
    assert all("InputError" in line for line in found)
