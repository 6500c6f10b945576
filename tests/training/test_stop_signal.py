"""Signals in processes of torchrun."""

import signal

from training.stop_signal import stop_signal


def test_two_signals_of_one_key_do_not_cut_torchrun_s_processes_short(monkeypatch):
    """The terminal sends one to every process of the group, and torchrun passes its own on."""
    monkeypatch.setenv("WORLD_SIZE", "2")
    with stop_signal() as stop:
        assert not stop()
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)
        assert stop()
