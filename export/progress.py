"""The stages of an export, as they are reported."""

from collections.abc import Callable

# What `report` of an export is called with: finished stages, all stages, the next one in words.
Report = Callable[[int, int, str], object]


class Progress:
    """Reports the stages of an export as they begin."""

    def __init__(self, total: int, report: Report) -> None:
        self._total, self._report, self._begun = total, report, 0

    def begin(self, text: str) -> None:
        """Report that the next stage begins."""
        self._begun += 1
        self.tell(text)

    def tell(self, text: str) -> None:
        """Report a step of the present stage."""
        self._report(self._begun - 1, self._total, text)
