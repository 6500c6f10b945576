"""Assumptions that a reader makes where a recording does not state a fact.

Every assumption that changes where a return lands is reported in one form: "warning: assumed ...".
A source collects the assumptions about its recording as notes; elsewhere they are Python warnings.
"""

import contextlib
import warnings
from collections.abc import Iterator
from contextvars import ContextVar

_notes: ContextVar[list[str] | None] = ContextVar("notes", default=None)


class AssumptionWarning(UserWarning):
    """A value was used in a way that its file does not prove."""


def assume(what: str, remedy: str) -> None:
    """Report an assumption, and the remedy that avoids it; each one is collected only once."""
    notes, line = _notes.get(), f"warning: assumed {what}: "
    if notes is None:
        warnings.warn(f"{line}{remedy}".removeprefix("warning: "), AssumptionWarning, stacklevel=3)
    elif not any(note.startswith(line) for note in notes):
        notes.append(line + remedy)


@contextlib.contextmanager
def collect_assumptions(notes: list[str]) -> Iterator[None]:
    """Append the assumptions that this thread makes inside the block to the notes of a source."""
    token = _notes.set(notes)
    try:
        yield
    finally:
        _notes.reset(token)
