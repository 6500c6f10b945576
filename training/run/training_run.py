"""A run of a recipe: what it is given beside the recipe, and what it returns."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from training.base.stop_signal import Stop, never
from training.weights.initial_weights import Weights


@dataclass(frozen=True)
class TrainingRun:
    """What controls a run and is no part of its recipe.

    Attributes:
        data: folders with the recipe's data sets.
        out: folder of the run.
        init: weights to start from; None: random weights, or those that the recipe names.
        teacher: weights whose answers are learned, too, see `training.losses.agreement`.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step, counted over all stages; the run can be resumed.
        stop: called between two steps, and between two frames of the survey and of a validation;
            True stops the run, which can be resumed.
    """

    data: Sequence[Path]
    out: Path
    init: Weights | None = None
    teacher: Weights | None = None
    device: str = "cpu"
    stop_after: int | None = None
    stop: Stop = never


@dataclass(frozen=True)
class RunResult:
    """What a run has made.

    Attributes:
        path: the checkpoint model.pt; of a run that was stopped the last.pt from which it resumes,
            which does not exist before the first step; of a dry run the picture batch.png.
        stopped: whether the run was stopped before its last step; the same call resumes it.
        lines: the result in words, for a dry run and for an adaptation.
    """

    path: Path
    stopped: bool = False
    lines: Sequence[str] = ()

    def __str__(self) -> str:
        """Return the result in words, or else its path."""
        return "\n".join(self.lines or [str(self.path)])
