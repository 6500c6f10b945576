"""Every model on every set with every LiDAR and fault."""

import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from runtime.app.encode import encode_metres
from runtime.base.errors import ContractError, InputError, OutputError
from runtime.contract.network_size import NetworkSize
from runtime.engine.bundled_models import find_model
from runtime.files.atomic_write import atomic_write, require_writable
from runtime.files.own_folder import require_folder_free
from training.datasets.class_mapping import ClassTable, is_mapped, list_classes
from training.datasets.sample import IGNORE, SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.distributed import parse_device
from training.evaluation.classical import METHODS
from training.evaluation.score_report import Row
from training.evaluation.scored_model import ScoredModel, open_method, open_scored_model
from training.evaluation.scoring import HeadMaps, Scores, figures_over_places
from training.lidar.faults import Fault, add_fault
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import open_dataset, spread_indices


@dataclass(frozen=True)
class DepthFolder:
    """Where depth is written: ``folder/MODEL/SET/LIDAR/FRAME.png``, 16-bit, metres x 256.

    Attributes:
        folder: is made with the first depth.
        overwrite: whether depth of the same names is replaced.
    """

    folder: Path
    overwrite: bool = False

    def require_free(self) -> None:
        """Raise an OutputError for a folder with other files or that cannot be written."""
        if not self.folder.is_dir():
            require_folder_free(self.folder, overwrite=self.overwrite)
        elif any(self.folder.iterdir()) and not self.overwrite:
            raise OutputError(
                f"{self.folder} is not empty: choose another --save, or replace depth of the same "
                "names with --overwrite"
            )
        else:
            require_writable(self.folder / "depth.png")

    def write(self, parts: Sequence[str], depth: NDArray[np.float32] | None) -> None:
        """Write a depth, float32 (H, W) [m], to the file of these folders and this name.

        Raises InputError if there is no depth, OutputError if the file cannot be written.
        """
        if depth is None:
            raise InputError(
                f"{parts[0]} predicts no depth to write with --save; leave that model out."
            )
        names = [re.sub(r"[^\w.-]+", "_", part).lstrip(".") or "_" for part in parts]
        path = self.folder.joinpath(*names[:-1], f"{names[-1]}.png")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path.parent}: cannot be made: {error.strerror}") from error
        atomic_write(path, encode_metres(depth), overwrite=self.overwrite)


@dataclass(frozen=True)
class ScoredClasses:
    """The classes that all models are scored in on a set, by their names.

    Attributes:
        table: that the set is opened with.
        names: of the classes that it and every model with classes have.
        left_out: the other classes in words; empty without any.
    """

    table: ClassTable
    names: tuple[str, ...]
    left_out: str = ""

    def lookup(self, table: ClassTable, others: int) -> NDArray[np.uint8]:
        """Return a look-up table (256,) from a table's ids to those of `names`, or ``others``."""
        names = _names(table)
        ids = np.full(256, IGNORE, np.uint8)
        ids[: len(names)] = [
            self.names.index(name) if name in self.names else others for name in names
        ]
        return ids


def evaluate(
    models: Sequence[str],
    data: Sequence[SourceRecipe],
    *,
    lidars: Sequence[LidarInput],
    faults: Sequence[Fault],
    device: str = "cpu",
    threads: int = 2,
    size: NetworkSize = None,
    limit: int | None = None,
    save: DepthFolder | None = None,
    leave_out_fed: bool = False,
) -> list[Row]:
    """Score models and classical methods of depth completion, in the order of their names.

    Every model gets the same inputs, and is scored in the same classes, see `scored_classes`. A set
    that cannot give a LiDAR has no row with it, see `training.lidar.split`. Where nothing was fed
    in any frame of a set there is one row, with the LiDAR "none" and no fault.

    Args:
        models: checkpoints (*.pt), exported models (*.onnx), names of bundled models and of
            `METHODS`.
        data: sets with absolute paths, or paths relative to the working directory.
        lidars: inputs that each set is scored with.
        faults: of these inputs; "none" for the input as it is.
        device: "cpu", "cuda" or "cuda:N".
        threads: of the processor.
        size: at which models run, as `Predictor` takes it.
        limit: number of frames of each set, evenly spread; None = all.
        save: where the depth of every answer is written; None = nowhere.
        leave_out_fed: no row, instead of an error, for a LiDAR that feeds the depth to score.

    Returns:
        One row per model, set, LiDAR and fault; without figures where a set has no ground truth.

    Raises:
        DatasetError, CheckpointError, ContractError, ProviderError: for what cannot be opened.
        InputError: for an invalid argument, a LiDAR that feeds the depth to score, labels without
            names where the models' classes differ, or if no set can give any of the LiDARs.
        OutputError: for depth that cannot be written.
    """
    rows: list[Row] = []
    parse_device(device)  # of methods, too, which have none
    with ExitStack() as stack:
        paths = {name: _find_file(name) for name in models if name not in METHODS}
        titles = dict(zip(paths, short_names(list(paths.values())), strict=True))
        scored: dict[str, ScoredModel] = {}
        for name in dict.fromkeys(models):
            if name in METHODS:
                scored[name] = open_method(name)
            else:
                opened = open_scored_model(paths[name], device=device, threads=threads, size=size)
                scored[titles[name]] = stack.enter_context(opened)
        folders = short_names([Path(recipe.path) for recipe in data])
        for recipe, folder in zip(data, folders, strict=True):
            title = recipe.name or " ".join([folder, *_changed_keys(recipe)])
            tables = {name: model.table for name, model in scored.items() if model.table}
            classes = scored_classes(recipe, title, tables)
            source = open_dataset(recipe, [Path()], classes=classes.table)
            for name, model in scored.items():
                rows += _score_all(
                    *(name, model, title, source, classes, lidars, faults, limit, save),
                    leave_out_fed=leave_out_fed,
                )
    if not rows:
        raise InputError(
            "nothing could be scored: these sets provide none of the requested --lidar inputs. "
            "Lines need intrinsics, or a recorded scan, every second line of which remains the "
            "target; use random:0.05 or none, which every set provides."
        )
    return rows


def scored_classes(
    recipe: SourceRecipe, title: str, tables: Mapping[str, ClassTable]
) -> ScoredClasses:
    """Return the classes of a set that models are scored in.

    Those of the models' table if all have the same and the labels are mapped to it, else those that
    the set and every model have by name.

    Args:
        recipe: of the set.
        title: of the set.
        tables: model -> its class table, of the models that have one.

    Raises:
        InputError: if the labels are ids of no named classes, and the models have several tables.
    """
    own, known = recipe.label_table, {name: _names(table) for name, table in tables.items()}
    first = next(iter(tables.values()), "camvid")
    same = len(set(known.values())) < 2
    if own is None and not same:
        several = "; ".join(f"{name}: {', '.join(names)}" for name, names in known.items())
        raise InputError(
            f"{title}: its labels are numbers, and the models have different classes ({several}). "
            'Name the numbers, for example label_ids={0 = "road", 1 = "car"}, or score the '
            "models one by one."
        )
    table = first if own is None or (same and is_mapped(own, first)) else own
    names = tuple(
        name for name in _names(table) if all(name in others for others in known.values())
    )
    alone = {
        where: [name for name in found if name not in names]
        for where, found in {title: _names(table), **known}.items()
    }
    left_out = "; ".join(f"{', '.join(found)} ({where})" for where, found in alone.items() if found)
    if left_out:
        outcome = (
            "left out of the mean, as a class must be one of the set and of every model"
            if names
            else "classes are not scored, as none of the set is one of every model"
        )
        left_out = f"{title}: {outcome}: {left_out}"
    return ScoredClasses(table, names, left_out)


def _names(table: ClassTable) -> tuple[str, ...]:
    return tuple(info.name for info in list_classes(table))


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name paths by their last parts, as few as make the names unique."""
    longest = max((len(path.parts) for path in paths), default=1)
    for parts in range(1, 1 + max(1, longest)):
        names = [str(Path(*path.parts[-parts:])) for path in paths]
        if len(set(names)) == len(set(paths)):
            break
    return names


def _find_file(name: str) -> Path:
    """Return the file of a model. Raises ContractError, which lists the methods, too."""
    try:
        return Path(name) if name.endswith(".pt") else find_model(name)
    except ContractError as error:
        raise ContractError(f"{error}. Classical methods: {', '.join(METHODS)}.") from error


def _changed_keys(recipe: SourceRecipe) -> list[str]:
    """What makes this set another than the same folder without options."""
    return [
        f"{item.name}={getattr(recipe, item.name)}"
        for item in fields(recipe)
        if item.name not in ("kind", "path") and getattr(recipe, item.name) != item.default
    ]


def _score_all(
    name: str,
    model: ScoredModel,
    title: str,
    source: SampleSource,
    classes: ScoredClasses,
    lidars: Sequence[LidarInput],
    faults: Sequence[Fault],
    limit: int | None,
    save: DepthFolder | None,
    *,
    leave_out_fed: bool,
) -> list[Row]:
    inputs = [(lidar, fault) for lidar in lidars for fault in faults]
    # Of every input by place, None = a place that the set does not know.
    scores: dict[tuple[LidarInput, Fault], dict[str | None, Scores]] = {item: {} for item in inputs}
    was_fed = dict.fromkeys(inputs, False)
    labelled = False
    label_ids = classes.lookup(classes.table, IGNORE)
    answer_ids = classes.lookup(model.table, len(classes.names))
    indices = spread_indices(source, limit or len(source))
    for index in tqdm(indices, desc=f"{name}, {title}", disable=None):
        sample = source[index]  # once: reading it may cost more than an answer
        labelled |= bool((sample.semantic != IGNORE).any())
        if "semantic" in sample.targets:
            sample = sample.with_targets(semantic=label_ids[sample.semantic])
        answers: dict[str, HeadMaps] = {}  # all inputs without returns share one answer
        for lidar, fault in inputs:
            rng = frame_generator(index)  # the same for every model, whatever the limit
            frame = split_lidar(sample, lidar, rng)
            if frame is None:
                continue
            if frame.target.any() and np.array_equal(frame.fed, frame.target):
                if leave_out_fed:
                    continue
                raise InputError(
                    f"{sample.name}: with the LiDAR {str(lidar)!r} the input is the depth to "
                    "score, so that an error of 0 would mean nothing. Feed a share with --lidar "
                    "random:0.5, or give denser depth."
                )
            fed, label = frame.fed, "none"
            if fed.any():
                was_fed[lidar, fault] = True
                fed = add_fault(fed, fault, rng)
                label = str(lidar) if fault == "none" else f"{lidar}-{fault}"
            if label not in answers:
                answer = model.predict(sample.rgb, fed, sample.focal_length_px)
                if answer.semantic is not None:
                    answer = answer._replace(semantic=answer_ids[answer.semantic])
                answers[label] = answer
                if save is not None:
                    parts = (name, title, label, *sample.name.split("/"))
                    save.write(parts, answers[label].depth)
            places = scores[lidar, fault]
            places.setdefault(sample.place, Scores(len(classes.names)))
            places[sample.place].update(answers[label], frame)
    rows: dict[tuple[str, str], Row] = {}
    for (lidar, fault), places in scores.items():
        key = (str(lidar), fault) if was_fed[lidar, fault] else ("none", "none")
        if places and key not in rows:
            total = Scores(len(classes.names))
            for part in places.values():
                total.merge(part)
            figures = total.figures(classes.names)
            # One threshold for the whole set, not the best threshold of each place.
            threshold = figures.get("boundary_threshold")
            by_place = {
                place: part.figures(classes.names, boundary_threshold=threshold)
                for place, part in places.items()
                if place is not None and None not in places and len(places) > 1
            }
            rows[key] = Row(
                *(name, model.engine, title, *key, total.frames, figures),
                places=by_place,
                figures_over_places=figures_over_places(by_place.values()),
                heads=sorted(total.heads),
                labelled=total.labelled(classes.names),
                left_out=classes.left_out if labelled and model.table else "",
                unscored=total.unscored(),
            )
    return list(rows.values())
