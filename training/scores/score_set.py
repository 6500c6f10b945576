"""The score of one model on one set, with every LiDAR input and fault."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from runtime.base.errors import InputError
from training.base.processes import Processes
from training.loading.camera_faults import CAMERA_FAULTS
from training.scores.depth_folder import DepthFolder
from training.scores.evaluated_set import EvaluatedSet, Feed
from training.scores.metrics import FARTHEST_M, Accumulator
from training.scores.scored_model import ScoredModel
from training.scores.scoring import HeadMaps, Scores, figures_over_places


@dataclass(frozen=True)
class Row:
    """The score of one model on one set with one LiDAR and one fault.

    Attributes:
        figures: figures over the pixels of all frames, in SI units and shares; empty without ground
            truth.
        places: figures by place, if the set knows the places of its frames and has several.
        figures_over_places: the mean over these places, see `figures_over_places`.
        heads: heads that the model answered.
        labelled: for each class, its labelled pixels, and the number of frames that show it.
        left_out: classes that are not scored, in words; empty if there are none.
        scored_labels: share of the labelled pixels whose class is scored.
        unscored: for "labels" or "depth", the share of its pixels that is not scored.
        farthest_m: farthest true depth [m] that is scored.
        latency_ms: median time of an answer on this machine, without reading; None if nothing ran.
        without_focal: number of frames without a focal length, if the model's distances depend on
            it.
    """

    model: str
    engine: str
    data: str
    lidar: str
    fault: str
    frames: int
    figures: dict[str, float]
    places: dict[str, dict[str, float]] = field(default_factory=dict)
    figures_over_places: dict[str, float] = field(default_factory=dict)
    heads: Sequence[str] = ()
    labelled: dict[str, tuple[int, int]] = field(default_factory=dict)
    left_out: str = ""
    scored_labels: float = 1.0
    unscored: dict[str, float] = field(default_factory=dict)
    farthest_m: float = FARTHEST_M
    latency_ms: float | None = None
    without_focal: int = 0

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Model, set, LiDAR and fault."""
        return self.model, self.data, self.lidar, self.fault

    @property
    def title(self) -> str:
        """Set, LiDAR and fault in words, which the rows of all models share."""
        return f"{self.data}, LiDAR {self.lidar}" + f", {self.fault}" * (self.fault != "none")

    @property
    def shown(self) -> dict[str, float | None]:
        """The figures and the time of an answer, by the keys of `score_report.COLUMNS`."""
        time = {} if self.latency_ms is None else {"latency_ms": self.latency_ms}
        return {**self.figures, **time}


@dataclass(frozen=True)
class FrameScore:
    """What a frame adds to the sums, for differences between models and for the worst frames.

    Attributes:
        index: index in the set.
        name: name of the frame.
        group: its place or drive; "" if unknown.
        confusion: int64 (C, C + 1), see `SemanticScores`.
        depth: float64 (3,), scored pixels, sum of |error| [m] and of its square.
        others: the same for each head without other figures.
    """

    index: int
    name: str
    group: str
    confusion: NDArray[np.int64]
    depth: NDArray[np.float64]
    others: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def error(self, head: str) -> float | None:
        """Return the share of wrong pixels, or the MAE [m]; None if nothing is scored."""
        if head == "semantic":
            pixels = self.confusion.sum()
            return float(1 - np.trace(self.confusion) / pixels) if pixels else None
        return float(self.depth[1] / self.depth[0]) if self.depth[0] else None


@dataclass(frozen=True)
class Result:
    """The score of one model on one set with one input.

    Attributes:
        row: its figures.
        feed: the LiDAR input and its fault.
        scores: the counts behind the figures.
        frames: the part of each frame.
        classes: names of the scored classes.
    """

    row: Row
    feed: Feed
    scores: Scores
    frames: Sequence[FrameScore]
    classes: tuple[str, ...]


class _Tally(Accumulator):
    """The score of one input so far: the sums of each place, the frames, and how many were fed."""

    def __init__(self) -> None:
        self.places: dict[str | None, Scores] = {}
        self.frames: list[FrameScore] = []
        self.fed = 0


class _SetTally(Accumulator):
    """The score of every input so far, and what the answers of a model have in common."""

    def __init__(self, feeds: Sequence[Feed]) -> None:
        self.inputs = {feed: _Tally() for feed in feeds}
        # Pixels with a label, and those with a class that is scored.
        self.labelled: NDArray[np.int64] = np.zeros(2, np.int64)
        self.times_ms: list[float] = []
        self.without_focal = 0


def score_sets(
    models: Mapping[str, ScoredModel],
    sets: Sequence[EvaluatedSet],
    feeds: Sequence[Feed],
    *,
    save: DepthFolder | None = None,
) -> list[Result]:
    """Score every model on every set, see `score_set`: set by set, in each the models by name.

    Raises:
        InputError: if no set can give any of the inputs.
    """
    results = [
        result
        for data in sets
        for name, model in models.items()
        for result in score_set(name, model, data, feeds, save=save)
    ]
    if not results:
        raise InputError(
            "nothing could be scored: these sets provide none of the requested --lidar inputs "
            "(lines need intrinsics, or a recorded scan, every second line of which remains "
            "the target): use random:0.05 or none, which every set provides"
        )
    return results


def score_set(
    name: str,
    model: ScoredModel,
    data: EvaluatedSet,
    feeds: Sequence[Feed],
    *,
    save: DepthFolder | None = None,
    processes: Processes | None = None,
) -> list[Result]:
    """Score a model on a set; see `evaluate` for the arguments.

    Of several `processes`, each scores its share of the frames, and all get the same results.

    Returns:
        A result for each input that the set can give.

    Raises:
        InputError: see `EvaluatedSet.split`.
    """
    tally = _SetTally(feeds)
    share = data.indices[processes.rank :: processes.count] if processes else data.indices
    # The bar stays unless it is below that of a training.
    for index in tqdm(share, desc=f"{name}, {data.title}", disable=None, leave=None):
        _score_frame(name, model, data, index, tally, save)
    if processes is not None:
        tally, *others = processes.gather(tally)
        for other in others:
            tally.merge(other)
    return _list_results(name, model, data, tally)


def _score_frame(
    name: str,
    model: ScoredModel,
    data: EvaluatedSet,
    index: int,
    tally: _SetTally,
    save: DepthFolder | None,
) -> None:
    """Answer a frame with every input that it gives, and count the answers."""
    sample, labelled = data.read(index)  # once: it may take longer than an answer
    tally.labelled += labelled
    tally.without_focal += sample.focal_length_px is None
    answers: dict[str, HeadMaps] = {}  # all inputs without returns share one answer
    for feed, label, frame, fed in data.split(sample, index, list(tally.inputs)):
        if label not in answers:
            started = perf_counter()
            answers[label] = data.answer(model, frame.sample, fed, index)
            tally.times_ms.append(1e3 * (perf_counter() - started))
            if save is not None:
                parts = (name, data.title, label, *sample.name.split("/"))
                save.write(parts, answers[label].depth)
        scores = data.begin_scores()
        scores.update(answers[label], frame)
        found = _Tally()
        found.places[sample.place] = scores
        group = data.group(sample, index)
        others = {head: sums.sums for head, sums in scores.others.items()}
        confusion, depth = scores.semantic.confusion, scores.depth.sums
        found.frames.append(FrameScore(index, sample.name, group, confusion, depth, others))
        found.fed += bool(frame.fed.any())
        tally.inputs[feed].merge(found)


def _list_results(
    name: str, model: ScoredModel, data: EvaluatedSet, counted: _SetTally
) -> list[Result]:
    """Return a result for each input; those that fed nothing in any frame are one."""
    results: dict[tuple[str, str], Result] = {}
    times_ms = [] if model.recorded else counted.times_ms
    for feed, tally in counted.inputs.items():
        lidar, fault = str(feed[0]), feed[1]
        if not tally.fed:
            lidar, fault = "none", fault if fault in CAMERA_FAULTS else "none"
        key = (lidar, fault)
        if not tally.frames or key in results:
            continue
        total, names = data.begin_scores(), data.classes.names
        for part in tally.places.values():
            total.merge(part)
        figures = total.figures(names) | means_over_images(tally.frames)
        # The whole set has one threshold; each place would have another best one.
        threshold = figures.get("boundary_threshold")
        by_place = {
            place: part.figures(names, boundary_threshold=threshold)
            for place, part in tally.places.items()
            if place is not None and None not in tally.places and len(tally.places) > 1
        }
        row = Row(
            *(name, model.engine, data.title, *key, total.frames, figures),
            places=by_place,
            figures_over_places=figures_over_places(by_place.values()),
            heads=sorted(total.heads),
            labelled=total.labelled(names),
            left_out=data.classes.left_out if counted.labelled[0] and model.table else "",
            scored_labels=float(counted.labelled[1] / max(1, counted.labelled[0])),
            unscored=total.unscored(),
            farthest_m=data.farthest_m,
            latency_ms=median(times_ms) if times_ms else None,
            without_focal=counted.without_focal if model.is_canonical else 0,
        )
        results[key] = Result(row, feed, total, tally.frames, names)
    return list(results.values())


def means_over_images(frames: Sequence[FrameScore]) -> dict[str, float]:
    """Return the means over the images of each image's MAE and RMSE [m]; {} without depth."""
    sums = np.array([frame.depth for frame in frames if frame.depth[0]])
    if not len(sums):
        return {}
    mae_m, square = (sums[:, 1:] / sums[:, :1]).mean(axis=0), np.sqrt(sums[:, 2] / sums[:, 0])
    return {"mae_m_per_image": float(mae_m[0]), "rmse_m_per_image": float(square.mean())}
