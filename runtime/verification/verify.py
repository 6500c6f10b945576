"""Comparison of the answers to the frames of a reference with the recorded answers."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InferenceError, InputError
from runtime.contract import agreement
from runtime.contract.contract import NO_CLASS, ClassInfo, Contract
from runtime.contract.heads import HEADS, Unit
from runtime.contract.model_file import load_model_file
from runtime.engine.predictor import Predictor
from runtime.verification.reference import Reference, ReferenceFrame

# A value or a limit for each figure of `agreement.compare`, by head.
Figures = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class WorstFigure:
    """The worst value of a limited figure over all frames.

    Attributes:
        head: name of the head.
        figure: name of the figure, see `agreement.compare`.
        worst: its worst value, which may be NaN; None if no frame has the head.
        limit: limit of the figure.
        frame: name of the worst frame; None if `worst` is None.
        frames_beyond: number of frames beyond the limit.
    """

    head: str
    figure: str
    worst: float | None
    limit: float
    frame: str | None
    frames_beyond: int


@dataclass(frozen=True)
class Fault:
    """A difference besides the values of heads: a text, and the frames to which it applies."""

    text: str
    frames: int
    first_frame: str


@dataclass(frozen=True)
class VerifyReport:
    """The comparison of a whole reference.

    Attributes:
        reference: the reference that was compared.
        failed: number of frames whose answers differ.
        figures: the worst value of each limited figure, in the order of the limits.
        faults: the differences besides the values of heads, each text once.
        median_ms: the median time of a prediction now; None if there is none.
        slowdown: `median_ms` divided by the recorded one; None if no times were recorded.
        max_slowdown: limit of `slowdown`; infinity: times are not compared.
        max_latency_ms: limit of `median_ms`; infinity: there is none.
    """

    reference: Reference
    failed: int
    figures: tuple[WorstFigure, ...]
    faults: tuple[Fault, ...]
    median_ms: float | None
    slowdown: float | None
    max_slowdown: float
    max_latency_ms: float

    @property
    def slow(self) -> bool:
        """Whether predictions take longer than `max_slowdown` or `max_latency_ms` allows."""
        is_slower = (self.slowdown or 0) > self.max_slowdown
        return is_slower or (self.median_ms or 0) > self.max_latency_ms

    @property
    def passed(self) -> bool:
        """Whether there are answers, and all agree with the recorded ones within the limits."""
        return bool(self.reference.frames) and not self.slow and not self.failed


def verify(
    predictor: Predictor,
    reference: Reference,
    *,
    tolerances: Figures,
    max_slowdown: float = math.inf,
    max_latency_ms: float = math.inf,
) -> VerifyReport:
    """Predict each recorded frame, and compare the answers with the recorded ones.

    Classes are compared by their names, whatever their ids are. If the predictor's file holds the
    recorded checkpoint in another precision, the limits are those of the less exact of the two
    files. Each new frame size is predicted once before it is timed.

    Args:
        predictor: answers the frames.
        reference: frames and answers.
        tolerances: limits by head and by figure: `agreement.figure_name`, or "" for the figure that
            `Head.tolerance` limits. Those of a head replace the recorded limits.
        max_slowdown: limit of the median time divided by the recorded one.
        max_latency_ms: limit of the median time of a prediction.

    Raises:
        ContractError: if the recorded model cannot be read.
        InputError: if the arrays of the reference are damaged, if it lacks a head of `tolerances`
            or the times for `max_slowdown`, or if the model has other classes.
    """
    if unknown := sorted(tolerances.keys() - reference.limits.keys()):
        raise InputError(
            f"`tolerances=` names {', '.join(unknown)}, the reference holds "
            f"{', '.join(reference.limits)}"
        )
    limits, lookup = dict(reference.limits), None
    if predictor.model.sha256 != reference.model_sha256:
        recorded = load_model_file(reference.model, sha256=reference.model_sha256).contract
        lookup = _class_lookup(predictor.contract.classes, recorded.classes)
        limits = _limits_for(predictor.contract, recorded, reference)
    for head, given in tolerances.items():
        limits[head] = {
            name or agreement.limited_figure(head): each for name, each in given.items()
        }
    warm: set[tuple[int, ...]] = set()
    of_heads: dict[str, list[tuple[str, Mapping[str, float]]]] = {head: [] for head in limits}
    of_texts: dict[str, list[str]] = {}  # text -> names of the frames
    failed, times_ms = 0, list[float]()
    for index, frame in enumerate(reference.frames):
        arrays = reference.arrays(index)
        figures, texts = _compare_frame(predictor, frame, arrays, limits, lookup, warm, times_ms)
        for head, each in figures.items():
            of_heads[head].append((frame.name, each))
        for text in texts:
            of_texts.setdefault(text, []).append(frame.name)
        is_within = all(agreement.within(each, limits[head]) for head, each in figures.items())
        failed += bool(texts) or not is_within
    recorded_ms = [each.predict_ms for each in reference.frames if each.predict_ms is not None]
    median_ms = statistics.median(times_ms) if times_ms else None
    slowdown = None
    if median_ms is not None and recorded_ms:
        slowdown = median_ms / max(statistics.median(recorded_ms), 1e-9)
    if max_slowdown < math.inf and slowdown is None:
        raise InputError(
            "`max_slowdown=` needs times, and this reference has none: record with ssdnet-run"
        )
    rows = tuple(
        _worst_figure(head, name, limit, of_heads[head])
        for head, each in limits.items()
        for name, limit in each.items()
    )
    faults = tuple(Fault(text, len(names), names[0]) for text, names in of_texts.items())
    times = median_ms, slowdown, max_slowdown, max_latency_ms
    return VerifyReport(reference, failed, rows, faults, *times)


def _worst_figure(
    head: str, name: str, limit: float, figures_by_frame: Sequence[tuple[str, Mapping[str, float]]]
) -> WorstFigure:
    """Return the worst value of a figure; `figures_by_frame` are those of the head."""
    if not figures_by_frame:
        return WorstFigure(head, name, None, limit, None, 0)
    value = agreement.worst([figures for _, figures in figures_by_frame])[name]
    # A NaN does not equal itself.
    frame = next(f for f, each in figures_by_frame if each[name] == value or math.isnan(each[name]))
    beyond = sum(not agreement.within(each, {name: limit}) for _, each in figures_by_frame)
    return WorstFigure(head, name, value, limit, frame, beyond)


def _limits_for(now: Contract, recorded: Contract, reference: Reference) -> dict[str, Any]:
    """The limits for another file; for the recorded checkpoint, those of the less exact file."""
    if now.checkpoint_sha256 != recorded.checkpoint_sha256:
        return dict(reference.limits)
    from_torch = reference.settings.from_torch
    coarse = agreement.less_exact(recorded, now)
    return {
        head: agreement.reference_limits(head, coarse, from_torch=from_torch)
        for head in reference.limits
    }


def _class_lookup(
    now: Sequence[ClassInfo], recorded: Sequence[ClassInfo]
) -> NDArray[np.uint8] | None:
    """Table (256,) from the ids of a model to the recorded ones; None if there are no classes.

    Raises InputError if the model has other classes.
    """
    names, known = [info.name for info in now], [info.name for info in recorded]
    if not names or not known:
        return None
    added, lacking = sorted({*names} - {*known}), sorted({*known} - {*names})
    if added or lacking:
        parts = [f"it adds {', '.join(added)}"] if added else []
        parts += [f"it lacks {', '.join(lacking)}"] if lacking else []
        raise InputError(
            f"`model=` has other classes than the reference ({'; '.join(parts)}): compare models "
            "of the same classes, or score each against labels with ssdnet-eval"
        )
    lookup = np.full(256, NO_CLASS, np.uint8)
    lookup[: len(names)] = [known.index(name) for name in names]
    return lookup


def _by_recorded_id(
    head: str, answer: NDArray[Any], lookup: NDArray[np.uint8] | None
) -> NDArray[Any]:
    """Return an answer with the ids of the recorded classes."""
    row = HEADS[head]
    if lookup is None:
        return answer
    if row.unit is Unit.CLASS_ID:
        ids: NDArray[np.uint8] = lookup[answer]
        return ids
    return answer[np.argsort(lookup[: len(answer)])] if row.per_class else answer


def _compare_frame(
    predictor: Predictor,
    frame: ReferenceFrame,
    arrays: dict[str, NDArray[Any]],
    limits: Figures,
    lookup: NDArray[np.uint8] | None,
    warm: set[tuple[int, ...]],
    times_ms: list[float],
) -> tuple[Figures, list[str]]:
    """Predict a frame again; return the figures of its heads, and what else differs, in words.

    `warm` holds the shapes of pictures that were predicted before; the time of the prediction is
    added to `times_ms`.
    """
    rgb, sparse_depth = arrays.pop("rgb"), arrays.pop("sparse_depth")
    figures: dict[str, dict[str, float]] = {}
    try:
        if rgb.shape not in warm:
            predictor.predict(rgb, sparse_depth, focal_length_px=frame.focal_length_px)
            warm.add(rgb.shape)
        prediction = predictor.predict(rgb, sparse_depth, focal_length_px=frame.focal_length_px)
    except InferenceError as error:
        return figures, [str(error)]
    times_ms.append(prediction.latency.total_ms)
    degraded = prediction.degraded if frame.degraded is None else frame.degraded
    faults = []
    for name, now, then in (
        ("valid", str(prediction.valid), str(frame.valid)),
        ("degraded", ", ".join(prediction.degraded), ", ".join(degraded)),
        ("heads", ", ".join(sorted(prediction.heads)), ", ".join(sorted(limits))),
    ):
        if now != then:
            faults.append(f"{name}: {now or 'none'}, expected {then or 'none'}")
    for head, expected in arrays.items():
        answer = prediction.heads.get(head)
        if answer is None:
            continue
        if answer.shape != expected.shape:
            faults.append(f"{head}: shape {answer.shape}, expected {expected.shape}")
            continue
        answer = _by_recorded_id(head, answer, lookup)
        figures[head] = agreement.compare(head, answer, expected, limits[head])
    return figures, faults
