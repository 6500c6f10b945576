"""Signals in processes of torchrun."""

import signal

import pytest

from training.base.stop_signal import StopRequested, never, stop_signal
from training.loading.open_dataset import Watched


def test_two_signals_of_one_key_do_not_cut_torchrun_s_processes_short(monkeypatch):
    """The terminal sends one to every process of the group, and torchrun passes its own on."""
    monkeypatch.setenv("WORLD_SIZE", "2")
    with stop_signal() as stop:
        assert not stop()
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)
        assert stop()


class Frames(list):
    """A data set that knows its files."""

    images = ("street/0.png", "street/1.png")


def test_a_watched_set_keeps_its_files_by_which_frames_are_grouped():
    assert Watched(Frames("ab"), never).images == Frames.images
    with pytest.raises(StopRequested):
        Watched(Frames("ab"), lambda: True)[0]
