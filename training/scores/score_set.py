"""The score of one model on one set, with every LiDAR input and fault."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from runtime.base.errors import InputError
from training.base.processes import Processes
from training.datasets.sample import Sample
from training.lidar.faults import add_fault
from training.lidar.split import LidarInput, LidarSplit, frame_generator, split_lidar
from training.loading.camera_faults import CAMERA_FAULTS, spoil
from training.scores.depth_folder import DepthFolder
from training.scores.evaluated_set import EvaluatedSet
from training.scores.score_report import Row
from training.scores.scored_model import ScoredModel
from training.scores.scoring import HeadMaps, Scores, figures_over_places

# A LiDAR input, and a fault of the LiDAR or the camera.
Feed = tuple[LidarInput, str]
# Strength of the faults of a camera, see `spoil`: a blur by 12 px, a tenth of the light.
CAMERA_FAULT_STRENGTH = 0.8


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


@dataclass
class _Tally:
    """The score of one input so far."""

    classes: int
    farthest_m: float
    places: dict[str | None, Scores] = field(default_factory=dict)
    frames: list[FrameScore] = field(default_factory=list)
    was_fed: bool = False

    def merge(self, other: "_Tally") -> None:
        for place, scores in other.places.items():
            if place in self.places:
                self.places[place].merge(scores)
            else:
                self.places[place] = scores
        self.frames += other.frames
        self.was_fed |= other.was_fed

    def add(self, answer: HeadMaps, frame: LidarSplit, index: int, group: str) -> None:
        scores = Scores(self.classes, self.farthest_m)
        scores.update(answer, frame)
        name, place = frame.sample.name, frame.sample.place
        confusion = scores.semantic.confusion.copy()
        others = {head: sums.sums for head, sums in scores.others.items()}
        part = FrameScore(index, name, group, confusion, scores.depth.sums, others)
        self.merge(_Tally(self.classes, self.farthest_m, {place: scores}, [part]))

    def total(self) -> Scores:
        total = Scores(self.classes, self.farthest_m)
        for part in self.places.values():
            total.merge(part)
        return total


@dataclass
class _SetTally:
    """The score of every input so far, and what the answers of a model have in common."""

    inputs: dict[Feed, _Tally]
    # Pixels with a label, and those with a class that is scored.
    labelled: NDArray[np.int64] = field(default_factory=lambda: np.zeros(2, np.int64))
    times_ms: list[float] = field(default_factory=list)
    without_focal: int = 0

    def merge(self, other: "_SetTally") -> None:
        for feed, tally in other.inputs.items():
            self.inputs[feed].merge(tally)
        self.labelled += other.labelled
        self.times_ms += other.times_ms
        self.without_focal += other.without_focal


def score_sets(
    models: Mapping[str, ScoredModel],
    sets: Sequence[EvaluatedSet],
    feeds: Sequence[Feed],
    *,
    save: DepthFolder | None = None,
    leave_out_fed: bool = False,
) -> list[Result]:
    """Score every model on every set, see `score_set`: set by set, in each the models by name.

    Raises:
        InputError: if no set can give any of the inputs.
    """
    results = [
        result
        for data in sets
        for name, model in models.items()
        for result in score_set(name, model, data, feeds, save=save, leave_out_fed=leave_out_fed)
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
    leave_out_fed: bool = False,
    processes: Processes | None = None,
) -> list[Result]:
    """Score a model on a set; see `evaluate` for the arguments.

    Of several `processes`, each scores its share of the frames, and all get the same results.

    Returns:
        A result for each input that the set can give.

    Raises:
        InputError: if a LiDAR feeds the depth to score and is not to be left out.
    """
    inputs = {feed: _Tally(len(data.classes.names), data.farthest_m) for feed in feeds}
    tally = _SetTally(inputs)
    share = data.indices[processes.rank :: processes.count] if processes else data.indices
    # The bar stays unless it is below that of a training.
    for index in tqdm(share, desc=f"{name}, {data.title}", disable=None, leave=None):
        _score_frame(name, model, data, index, tally, save=save, leave_out_fed=leave_out_fed)
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
    *,
    save: DepthFolder | None,
    leave_out_fed: bool,
) -> None:
    """Answer a frame with every input that it gives, and count the answers."""
    sample, labelled = data.read(index)  # once: it may take longer than an answer
    tally.labelled += labelled
    tally.without_focal += sample.focal_length_px is None
    answers: dict[str, HeadMaps] = {}  # all inputs without returns share one answer
    for feed, label, frame, fed in split_feeds(
        sample, index, list(tally.inputs), leave_out_fed=leave_out_fed
    ):
        tally.inputs[feed].was_fed |= bool(frame.fed.any())
        if label not in answers:
            started = perf_counter()
            answers[label] = data.answer(model, frame.sample, fed, index)
            tally.times_ms.append(1e3 * (perf_counter() - started))
            if save is not None:
                parts = (name, data.title, label, *sample.name.split("/"))
                save.write(parts, answers[label].depth)
        tally.inputs[feed].add(answers[label], frame, index, data.group(sample, index))


def _list_results(
    name: str, model: ScoredModel, data: EvaluatedSet, counted: _SetTally
) -> list[Result]:
    """Return a result for each input; those that fed nothing in any frame are one."""
    results: dict[tuple[str, str], Result] = {}
    times_ms = [] if model.recorded else counted.times_ms
    for feed, tally in counted.inputs.items():
        lidar, fault = str(feed[0]), feed[1]
        if not tally.was_fed:
            lidar, fault = "none", fault if fault in CAMERA_FAULTS else "none"
        key = (lidar, fault)
        if not tally.frames or key in results:
            continue
        total = tally.total()
        figures, by_place = _figures(total, tally.places, data.classes.names)
        figures |= means_over_images(tally.frames)
        row = Row(
            *(name, model.engine, data.title, *key, total.frames, figures),
            places=by_place,
            figures_over_places=figures_over_places(by_place.values()),
            heads=sorted(total.heads),
            labelled=total.labelled(data.classes.names),
            left_out=data.classes.left_out if counted.labelled[0] and model.table else "",
            scored_labels=float(counted.labelled[1] / max(1, counted.labelled[0])),
            unscored=total.unscored(),
            farthest_m=data.farthest_m,
            latency_ms=median(times_ms) if times_ms else None,
            without_focal=counted.without_focal if model.is_canonical else 0,
        )
        results[key] = Result(row, feed, total, tally.frames, data.classes.names)
    return list(results.values())


def means_over_images(frames: Sequence[FrameScore]) -> dict[str, float]:
    """Return the means over the images of each image's MAE and RMSE [m]; {} without depth."""
    sums = np.array([frame.depth for frame in frames if frame.depth[0]])
    if not len(sums):
        return {}
    mae_m, square = (sums[:, 1:] / sums[:, :1]).mean(axis=0), np.sqrt(sums[:, 2] / sums[:, 0])
    return {"mae_m_per_image": float(mae_m[0]), "rmse_m_per_image": float(square.mean())}


def split_feeds(
    sample: Sample, index: int, feeds: Sequence[Feed], *, leave_out_fed: bool
) -> Iterator[tuple[Feed, str, LidarSplit, NDArray[np.float32]]]:
    """Yield the inputs that a frame gives: the feed, its name, the split, and what is fed.

    The image of the split is that of a faulty camera, if the feed has such a fault.
    """
    for feed in feeds:
        lidar, fault = feed
        rng = frame_generator(index)  # the same for every model, whatever the limit
        frame = split_lidar(sample, lidar, rng)
        if frame is None:
            continue
        if frame.target.any() and np.array_equal(frame.fed, frame.target):
            if leave_out_fed:
                continue
            raise InputError(
                f"{sample.name}: with the LiDAR {str(lidar)!r} the input is the depth to "
                "score, so that an error of 0 would mean nothing: feed a share with --lidar "
                "random:0.5, or give denser depth"
            )
        name = str(lidar) if frame.fed.any() else "none"
        if fault in CAMERA_FAULTS:
            image = spoil(frame.sample.rgb, fault, CAMERA_FAULT_STRENGTH, rng)
            frame = frame._replace(sample=frame.sample.with_image(image))
            yield feed, f"{name}-{fault}", frame, frame.fed
        elif fault == "none" or name == "none":
            yield feed, name, frame, frame.fed
        else:
            yield feed, f"{name}-{fault}", frame, add_fault(frame.fed, fault, rng)


def _figures(
    total: Scores, places: Mapping[str | None, Scores], names: Sequence[str]
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return the figures of a whole set, and those by place if all frames have one."""
    figures = total.figures(names)
    # The whole set has one threshold; each place would have another best one.
    threshold = figures.get("boundary_threshold")
    by_place = {
        place: part.figures(names, boundary_threshold=threshold)
        for place, part in places.items()
        if place is not None and None not in places and len(places) > 1
    }
    return figures, by_place
