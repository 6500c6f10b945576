"""The rule that chooses among readings, and the judgement of the frames of a recording.

First it is asked whether the answers to the images alone are good enough to judge by. Then all
readings are compared by one score on the same frames. A reading wins if its gain over the view as
given, in blocks of frames that did not choose it, is clear. Readings with about the same gain are
named together. Limits and measured values: docs/recordings.md.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from runtime.base.arrays import Float64
from runtime.checks.finding import Finding, Severity
from runtime.checks.fit import FitScores, fit_of, median_fit
from runtime.checks.readings import READINGS, Reading
from runtime.checks.view import Answer, View
from runtime.contract.degraded import IMPLAUSIBLE_DEPTH

FIRST_FRAMES = 5  # frames that are judged when a stream starts; later the last 5 count
# Findings that are no readings, with what they mean.
NO_EVIDENCE, NOWHERE, NO_RETURNS = "no_evidence", "nowhere", "no_returns"
# Least evidence in the answer to an image alone, medians over the frames: the standard deviation of
# the boundaries, and their correlation with the steps of the predicted depth. By day they are 0.12
# and 0.19 or more, on a motorway by night 0.11 and 0.00. In images with a sixteenth of the light,
# with strong noise, or blurred, one of them is less.
_LEAST_BOUNDARY, _LEAST_AGREEMENT = 0.1, 0.12
_FITS = 1.0  # score from which far readings are not tried; right recordings have 0.6 to 1.5
_LEAST_RETURNS, _LEAST_RELIEF = 200, 0.01  # of a frame that is judged; of its log depth
# Correlations of depth maps of different scenes are below these, as they are and without the mean
# of each band of rows, in at least _KNOWN frames. Right returns have medians of at least 0.6 and
# 0.4; swapped bytes and shuffled returns have 0.1 or less.
_ALIKE, _UNALIKE, _UNALIKE_IN_BANDS, _KNOWN = 0.5, 0.3, 0.2, 3
_ERRORS = 2.0  # a gain is clear above so many of its standard errors
_APART = 0.02  # readings whose gains differ by less are named together
_MOST_NAMED = 3


class Choice(NamedTuple):
    """What wins.

    Attributes:
        readings: names of the reading and of those with about the same gain, with their members.
        gain: gain over the view as given, on frames that did not choose it, median.
        unclear: names of readings that are not told apart from it either, but whose gain over the
            view as given is not clear.
    """

    readings: tuple[tuple[str, str], ...]
    gain: float
    unclear: tuple[str, ...]


def choose(
    gains: Mapping[tuple[str, str], Float64], floors: Mapping[str, float], apart: float = _APART
) -> Choice | None:
    """Return the reading with a clear gain; None if there is none.

    Args:
        gains: gain of each frame over the view as given, by reading and member.
        floors: least gain of each reading.
        apart: least difference of two readings that are told apart.
    """
    families: dict[str, dict[str, Float64]] = defaultdict(dict)
    for (name, member), each in gains.items():
        families[name][member] = each
    held_out = {name: _held_out(members) for name, members in families.items()}
    clear = [name for name, each in held_out.items() if _is_clear(each, floors[name])]
    best = max(clear, key=lambda name: float(np.median(held_out[name])), default=None)
    if best is None:
        return None
    alike = [
        name
        for name in families
        if name == best or not _is_clear(held_out[best] - held_out[name], apart)
    ]
    named = (
        (name, max(families[name], key=lambda each, of=name: families[of][each].mean()))  # type: ignore[misc]
        for name in alike
        if name in clear
    )
    unclear = (name for name in alike if name not in clear)
    return Choice(tuple(named), float(np.median(held_out[best])), tuple(unclear))


def _held_out(members: Mapping[str, Float64]) -> Float64:
    """The gain in each block of frames of the member that is best in the other blocks."""
    table = np.stack(list(members.values()))
    blocks = np.array_split(np.arange(table.shape[1]), min(table.shape[1], FIRST_FRAMES))
    if len(blocks) == 1:
        return np.asarray(table.max(axis=0))
    chosen = (np.delete(table, block, axis=1).mean(axis=1).argmax() for block in blocks)
    return np.concatenate([table[at, block] for at, block in zip(chosen, blocks, strict=True)])


def _is_clear(gains: Float64, floor: float) -> bool:
    error = gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return bool(np.median(gains) >= floor and gains.mean() >= _ERRORS * error)


_UNKNOWN = FitScores()


@dataclass(frozen=True)
class Judgement:
    """What the frames show.

    Attributes:
        findings: what was found.
        tested: names of the readings that are found, or fit clearly worse than what fits best: what
            is found, else the recording as given.
        not_tested: names of those that these frames do not tell apart from what fits best.
        fit: the figures as given, medians.
        frames: number of frames that were judged.
    """

    findings: tuple[Finding, ...] = ()
    tested: tuple[str, ...] = ()
    not_tested: tuple[str, ...] = ()
    fit: FitScores = _UNKNOWN
    frames: int = 0

    @property
    def text(self) -> str:
        """What was tested, in a line."""
        if not self.tested:
            return "no other reading of the recording can be tested"
        alike = ", ".join(self.not_tested)
        best = "what was found" if self.findings else "the recording as given"
        rest = f"; not told apart from {best}: {alike}" if alike else ""
        return f"{len(self.tested)} other readings of the recording were tested{rest}"

    def to_dict(self) -> dict[str, Any]:
        """The judgement for JSON, without its findings."""
        figures = {**self.fit._asdict(), "score": self.fit.score}
        tested = {"tested": self.tested, "not_tested": self.not_tested}
        return {"frames": self.frames, "fit": figures, **tested}


class _Seen(NamedTuple):
    """A judged frame: its view, its fit as given, and the gains of readings and members."""

    view: View
    fit: FitScores
    gains: dict[tuple[str, str], float]


class Judge:
    """Judges the last frames of a stream by the answers to their images alone.

    Args:
        readings: rows of the table.
        most: number of frames that count.
        floor: the floors of small readings are multiplied by this.
    """

    def __init__(
        self, readings: Iterable[Reading] = READINGS, *, most: int = FIRST_FRAMES, floor: float = 1
    ) -> None:
        self._readings = {each.name: each for each in readings}
        self._floors = {
            name: each.floor * (1 if each.severity is Severity.FAULT else floor)
            for name, each in self._readings.items()
        }
        self._seen: deque[_Seen] = deque(maxlen=most)

    def add(self, view: View) -> None:
        """Add a frame; it is ignored with few returns in the image, but not without any."""
        fit = fit_of(view)
        gains: dict[tuple[str, str], float] = {}
        is_flat = float(np.ptp(view.answer.log_depth)) < _LEAST_RELIEF
        if fit.returns and (is_flat or fit.returns < _LEAST_RETURNS):
            return
        for reading in self._readings.values():
            if not reading.is_far or fit.score < _FITS:
                for member, each in reading.views(view):
                    if (other := fit_of(each)).returns >= _LEAST_RETURNS:
                        key, gain = (reading.name, member), other.score - fit.score
                        gains[key] = max(gain, gains.get(key, gain))
        self._seen.append(_Seen(view, fit, gains))

    def judgement(self) -> Judgement:
        """What the frames so far show."""
        if not self._seen:
            return Judgement()
        views, rows = [each.view for each in self._seen], self._readings
        fit = median_fit([each.fit for each in self._seen])
        keys = dict.fromkeys(key for each in self._seen for key in each.gains)
        gains = {key: np.array([each.gains.get(key, 0.0) for each in self._seen]) for key in keys}
        weak = _evidence_fault([view.answer for view in views])
        if weak is not None:  # only a change of the images may win
            gains = {key: each for key, each in gains.items() if rows[key[0]].changes_image}
        choice = choose(gains, self._floors) if gains else None
        if choice is not None:
            findings = [self._told(choice, views, fit)]
        elif not fit.returns:
            findings = [_NO_RETURNS]
        else:
            findings = [weak] if weak else _nowhere(fit, len(views), len(gains))
        if weak is not None and choice is None:
            return Judgement(tuple(findings), (), tuple(rows), fit, len(views))
        change: dict[str, float] = defaultdict(float)
        for key in gains:
            tried = [each.gains[key] for each in self._seen if key in each.gains]
            change[key[0]] = max(change[key[0]], abs(float(np.median(tried))))
        alike = [name for name in change if change[name] < self._floors[name]]
        if choice is not None:
            alike = [*choice.unclear]
        tested = tuple(name for name in change if name not in alike)
        not_tested = tuple(name for name in alike if name != "unit")
        return Judgement(tuple(findings), tested, not_tested, fit, len(views))

    def _told(self, choice: Choice, views: Sequence[View], fit: FitScores) -> Finding:
        rows = [(self._readings[name], member) for name, member in choice.readings]
        says, *others = (row.told(member, views) for row, member in rows[:_MOST_NAMED])
        if others:
            says = f"{len(rows)} readings fit: " + "; or ".join([says, *others])
        evidence = {"fit as given": fit.score, "better by": choice.gain}
        if all(row.severity is Severity.FAULT for row, _ in rows):
            return Finding(rows[0][0].name, says, Severity.FAULT, evidence, IMPLAUSIBLE_DEPTH)
        return Finding(rows[0][0].name, says, Severity.WARNING, evidence)


def _evidence_fault(answers: Collection[Answer]) -> Finding | None:
    """Why nothing can be judged by these answers to images alone; None if it can."""
    boundary, agreement = np.median([each.evidence for each in answers], axis=0)
    figures = {"strength of boundaries": float(boundary), "their fit to depth": float(agreement)}
    doubts = Counter(doubt for each in answers for doubt in each.doubts)
    figures |= {doubt: count / len(answers) for doubt, count in doubts.items()}
    is_doubtful = 2 * sum(bool(each.doubts) for each in answers) > len(answers)
    if boundary >= _LEAST_BOUNDARY and agreement >= _LEAST_AGREEMENT and not is_doubtful:
        return None
    says = "the images are too dark, blurred or noisy to judge returns and calibration by them"
    return Finding(NO_EVIDENCE, says, Severity.NOTE, figures)


_NO_RETURNS = Finding(
    NO_RETURNS,
    "no scan or depth map of the first frames has a return in the image: check that scans are in "
    "metres, and that the extrinsics of the calibration lead from the LiDAR to the camera",
    Severity.FAULT,
)


def _nowhere(fit: FitScores, frames: int, tried: int) -> list[Finding]:
    is_unalike = fit.depth_correlation < _UNALIKE and fit.in_bands < _ALIKE
    is_unalike |= fit.in_bands < _UNALIKE_IN_BANDS and frames >= _KNOWN
    if not is_unalike:
        return []
    says = (
        f"the returns fit the image nowhere, neither as given nor in {tried} other readings, which "
        "ssdnet-doctor --readings lists. Check that image and depth are of the same moment, the "
        "extrinsics, and the byte order of 16-bit depth maps"
    )
    evidence = {"correlation": fit.depth_correlation, "without the mean of each row": fit.in_bands}
    return [Finding(NOWHERE, says, Severity.FAULT, evidence, IMPLAUSIBLE_DEPTH)]
