"""What is assumed is collected by a source, and else a warning of Python."""

import threading

import pytest

from runtime.geometry.assumptions import AssumptionWarning, assume, collect_assumptions


def test_an_assumption_is_collected_once_in_its_thread():
    notes = ["topics"]

    def elsewhere():
        with pytest.warns(AssumptionWarning, match="^assumed the same: see there$"):
            assume("the same", "see there")

    with collect_assumptions(notes):
        for remedy in ("see line 1", "see line 2"):
            assume("the same", remedy)
        assume("the same but for this", "see line 3")
        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
    elsewhere()
    assert notes == [
        "topics",
        "warning: assumed the same: see line 1",
        "warning: assumed the same but for this: see line 3",
    ]
