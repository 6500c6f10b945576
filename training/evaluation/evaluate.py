"""Every model on every set with every LiDAR and fault."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from runtime.errors import InputError
from runtime.network_size import NetworkSize
from training.datasets.sample import SampleSource
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.exported_model import ScoredModel, open_method, open_model
from training.evaluation.score_report import Row
from training.evaluation.scoring import Answer, Scores
from training.lidar.faults import Fault, add_fault
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import open_dataset


def evaluate(
    models: Sequence[Path],
    data: Sequence[SourceRecipe],
    *,
    lidars: Sequence[LidarInput],
    faults: Sequence[Fault],
    methods: Sequence[str] = (),
    device: str = "cpu",
    threads: int = 2,
    size: NetworkSize = None,
    limit: int | None = None,
) -> list[Row]:
    """Score models, and classical methods of depth completion by name.

    ``data`` are sets whose paths stand by themselves. What a LiDAR stands for on each kind of set
    says `training.lidar.split`; a set that cannot give one has no row with it. Where nothing was
    fed in any frame of a set there is one row, with the LiDAR "none" and no fault, whatever was
    asked for. Every model gets the same inputs, whatever else is asked for. ``limit`` takes that
    many frames of a set, evenly spread. ``size`` is that at which every model runs, as
    `Predictor` takes it.

    Raises DatasetError, InputError, CheckpointError, ContractError and ProviderError for what
    cannot be opened, InputError if nothing could be scored.
    """
    rows: list[Row] = []
    with ExitStack() as stack:
        opened = {
            path: stack.enter_context(open_model(path, device=device, threads=threads, size=size))
            for path in models
        }
        model_names = short_names(list(opened))
        scored = dict(zip(model_names, opened.values(), strict=True))
        scored |= {name: open_method(name) for name in methods}
        folders = short_names([Path(recipe.path) for recipe in data])
        for recipe, folder in zip(data, folders, strict=True):
            title = " ".join([folder, *_changed_keys(recipe)])

            for name, model in scored.items():
                source = open_dataset(recipe, [Path()], classes=model.class_table)
                rows += _score_all(name, model, title, source, lidars, faults, limit)
    if not rows:
        raise InputError(
            "nothing could be scored: these sets give none of the LiDARs asked for. Lines need "
            "the set's intrinsics, or a recorded scan, of which every second line stays the "
            "target; ask for random:0.05 or none, which every set gives."
        )
    return rows


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name each path by as few of its last parts as tell them all apart."""
    longest = max((len(path.parts) for path in paths), default=1)
    for parts in range(1, 1 + max(1, longest)):
        names = [str(Path(*path.parts[-parts:])) for path in paths]
        if len(set(names)) == len(set(paths)):
            break
    return names


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
    lidars: Sequence[LidarInput],
    faults: Sequence[Fault],
    limit: int | None,
) -> list[Row]:
    count = len(source) if limit is None else min(limit, len(source))
    indices = np.unique(np.linspace(0, len(source) - 1, count).round().astype(int))
    inputs = [(lidar, fault) for lidar in lidars for fault in faults]
    scores = {item: Scores(len(model.classes)) for item in inputs}
    was_fed = dict.fromkeys(inputs, False)
    for index in tqdm(indices, desc=f"{name}, {title}", disable=None):
        sample = source[int(index)]  # once: reading it may cost more than an answer
        camera_alone: Answer | None = None  # the same for all inputs that feed nothing
        for lidar, fault in inputs:
            rng = frame_generator(int(index))  # the same for every model, whatever the limit
            frame = split_lidar(sample, lidar, rng)
            if frame is None:
                continue
            if frame.fed.any():
                was_fed[lidar, fault] = True
                fed = add_fault(frame.fed, fault, rng)
                answer = model.predict(sample.rgb, fed, sample.focal_length_px)
            else:
                if camera_alone is None:
                    camera_alone = model.predict(sample.rgb, frame.fed, sample.focal_length_px)
                answer = camera_alone
            scores[lidar, fault].update(answer, frame)
    class_names = [info.name for info in model.classes]
    rows = {}
    for (lidar, fault), item in scores.items():
        if item.frames:
            names = (str(lidar), fault) if was_fed[lidar, fault] else ("none", "none")
            if names not in rows:
                figures = item.figures(class_names)
                rows[names] = Row(name, model.engine, title, *names, item.frames, figures)
    return list(rows.values())
