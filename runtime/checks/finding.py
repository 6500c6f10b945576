"""A finding: the one form of what checks say, in terminals, reports, results and Python."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class Severity(StrEnum):
    """What follows from a finding."""

    NOTE = "note"  # something was not judged
    WARNING = "warning"  # answers are usable; something should be looked at
    FAULT = "fault"  # answers that use these returns or poses cannot be right


@dataclass(frozen=True)
class Finding:
    """What the frames of a recording show.

    Attributes:
        name: name of a row of `READINGS`, or one of `OTHERS`; --accept takes it.
        says: what seems to be so, and what to change in file, option or call.
        severity: what follows.
        evidence: the figures on which it rests, by name.
        reason: the reason in `Prediction.degraded` for frames with a fault; "" if there is none.
    """

    name: str
    says: str
    severity: Severity
    evidence: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""

    @property
    def text(self) -> str:
        """The finding in one line."""
        figures = ", ".join(f"{name} {value:.3g}" for name, value in self.evidence.items())
        return f"{self.says} ({figures})" if figures else self.says

    @property
    def line(self) -> str:
        """The line of a terminal or page."""
        return f"{'note' if self.severity is Severity.NOTE else 'warning'}: {self.text}"

    def to_dict(self) -> dict[str, Any]:
        """The finding for JSON."""
        return {**asdict(self), "text": self.text}
