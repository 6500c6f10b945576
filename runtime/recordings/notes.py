"""What a reader says about a recording: assumptions, guesses, and what is in no frame."""

from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager

from runtime.geometry.assumptions import collect_assumptions


class Notes:
    """Lines about a recording.

    Attributes:
        lines: assumptions and guesses, each once.
        left_out: counts of what is in no frame, such as "image: duplicate".
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.left_out: Counter[str] = Counter()

    def add(self, line: str) -> None:
        """Add a line; the frames may be listed more than once."""
        if line not in self.lines:
            self.lines.append(line)

    def collecting(self) -> AbstractContextManager[None]:
        """Collect the assumptions that this thread makes inside a block."""
        return collect_assumptions(self.lines)

    @property
    def texts(self) -> tuple[str, ...]:
        """All lines, the last one with the counts."""
        return (*self.lines, *left_out_note(self.left_out))


def left_out_note(left_out: Mapping[str, int]) -> tuple[str, ...]:
    """One line with the counts of what is in no frame, or no line if there is nothing."""
    counts = ", ".join(f"{reason} {count}" for reason, count in sorted(left_out.items()))
    return (f"left out: {counts}",) if counts else ()
