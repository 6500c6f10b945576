"""Scores of every model on every set with every LiDAR and fault, and how the models differ."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from runtime.base.errors import InputError
from runtime.contract.network_size import NetworkSize
from runtime.engine.bundled_models import find_model, list_bundled_models
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.classical import METHODS
from training.evaluation.open_model import open_method, open_predictions, open_scored_model
from training.evaluation.options import EvaluationOptions
from training.evaluation.own_frames import own_frames, united_classes
from training.lidar.faults import LidarFault
from training.lidar.split import LidarInput
from training.loading.camera_faults import CameraFault
from training.pages.worst_frames import WorstFrame, draw_worst
from training.run.finished_run import EvaluatedRun, read_run
from training.scores.differences import LEAST_SCORED, Difference, compare
from training.scores.evaluated_set import open_sets, short_names
from training.scores.metrics import FARTHEST_M
from training.scores.score_report import format_differences, format_table
from training.scores.score_set import Result, Row, score_sets
from training.scores.scored_model import ScoredModel
from training.scores.shared_classes import draft_join

Fault = Literal["none"] | LidarFault | CameraFault


@dataclass(frozen=True)
class Evaluation:
    """The result of `evaluate`.

    Attributes:
        results: a result for each model, set, LiDAR and fault. The sets are in their order, and in
            each set the models are in theirs.
        differences: differences of every model to the first, on each set with each input.
        worst: pictures of the frames with the largest errors.
        draft: joint classes, by the meanings of names, where few labels are scored without them.
    """

    results: Sequence[Result]
    differences: Sequence[Difference] = ()
    worst: Sequence[WorstFrame] = ()
    draft: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the tables that `ssdnet-eval` prints, with lines of any length."""
        return format_table(self.rows) + format_differences(self.differences)

    @property
    def rows(self) -> list[Row]:
        """The figures of each result."""
        return [result.row for result in self.results]


def evaluate(
    models: Sequence[str | Path],
    data: Sequence[str | SourceRecipe] = (),
    *,
    lidars: Sequence[str | LidarInput] | None = None,
    faults: Sequence[Fault] = ("none",),
    predictions: Sequence[str] = (),
    adapters: Sequence[Path] = (),
    join: Mapping[str, Sequence[str]] | None = None,
    device: str = "cpu",
    threads: int = 2,
    size: NetworkSize = None,
    limit: int | None = None,
    farthest_m: float | None = None,
) -> Evaluation:
    """Score models, predictions and classical methods of depth completion on data sets.

    Every model gets the same inputs, and is scored in the same classes, see `share_classes`. A set
    that cannot give a LiDAR has no row with it, see `training.lidar.split`. If nothing was fed in
    any frame of a set, there is one row, with the LiDAR "none" and no fault.

    Args:
        models: checkpoints (*.pt), exported models (*.onnx), networks of others (*.onnx, with an
            adapter), folders of runs, names of bundled models and of `METHODS`.
        data: sets as on the command line, KIND:FOLDER[,KEY=VALUE...], or as in a recipe, with
            absolute paths or paths relative to the working directory. Empty: the validation sets of
            the first run among the models.
        lidars: inputs with which each set is scored, see `LidarInput.parse`. None: that of the
            run's validation, or "own".
        faults: faults of these inputs; "none" for the input as it is.
        predictions: folders of answers, DIR[,KEY=VALUE...], scored after the models, see
            `training.evaluation.predictions`.
        adapters: TOML files of the networks of others, in the order of these; a network without one
            here uses its own file beside it, NAME.toml. See `training.evaluation.adapter`.
        join: for each joint class, the classes of sets and models that count as it, such as
            `{"vehicle": ["car", "truck"]}`.
        device: "cpu", "cuda" or "cuda:N".
        threads: threads of the processor.
        size: size at which models with a free size run, as `Predictor` takes it.
        limit: number of frames of each set, evenly spread; None: all.
        farthest_m: farthest true depth [m] that is scored; None: that of the run's validation, or
            `FARTHEST_M`.

    Returns:
        A row for each model, set, LiDAR and fault, without figures if a set has no ground truth,
        and the differences of the models to the first.

    Raises:
        DatasetError, CheckpointError, ContractError, ProviderError: if something cannot be opened.
        MissingAdapterError: if a network of others has no adapter.
        InputError: if an argument is invalid, if a LiDAR feeds the depth to score, if labels have
            no names where the models' classes differ, or if no set can give any of the LiDARs.
    """
    return score_models(EvaluationOptions(**locals()))  # fields and arguments have the same names


def score_models(options: EvaluationOptions) -> Evaluation:
    """Score what the options name, see `evaluate`; for a page the worst frames are drawn.

    Raises OutputError if depth cannot be written, and the errors of `evaluate`.
    """
    given, inputs = options.sets, options.inputs
    runs = _read_runs(options.models)
    first = next(iter(runs.values()), None)
    sets = [*given, *own_frames(options, first)]
    # The run whose validation sets are scored.
    own = None if sets else first
    sets = sets if own is None else list(own.sets)
    if not sets:
        raise InputError(
            "no data to score on: give --images with --labels, --data KIND:FOLDER, or the folder "
            "of a run whose recipe has validation sets"
        )
    # Labels without names are those of the first run.
    ids = None if first is None else first.recipe.model.class_table
    farthest_m, lidar = FARTHEST_M, "own"
    if own is not None:
        validation = own.recipe.validation
        farthest_m, lidar = validation.farthest_m, validation.lidar
    with ExitStack() as stack:
        models = _open_models(options, runs, stack)
        opened = open_sets(
            sets,
            {name: model.table for name, model in models.items() if model.table},
            ids=ids,
            join=options.join,
            limit=options.limit,
            farthest_m=options.farthest_m or farthest_m,
        )
        used = dict.fromkeys(inputs or [LidarInput.parse(lidar)])
        feeds = [(each, fault) for each in used for fault in dict.fromkeys(options.faults)]
        results = score_sets(models, opened, feeds, save=options.save_to)
        worst = list(draw_worst(results, models, opened)) if options.page is not None else ()
        draft = _draft(options, sets, first, results, models)
        return Evaluation(results, compare(results), worst, draft)


def _draft(
    options: EvaluationOptions,
    sets: Sequence[SourceRecipe],
    run: EvaluatedRun | None,
    results: Sequence[Result],
    models: Mapping[str, ScoredModel],
) -> Mapping[str, Sequence[str]]:
    """Return a draft of `join` if too few labels are scored by the names as they are."""
    few = [item for item in results if item.row.scored_labels < LEAST_SCORED]
    if not few or options.join:
        return {}
    trained = run.recipe.model if run else None
    own = trained.classes if trained and not isinstance(trained.classes, str) else ()
    united: dict[str, Sequence[str]] = {info.name: info.of for info in own if info.of}
    united |= united_classes(options)
    groups: dict[str, Sequence[str]] = {}
    for recipe in sets:
        tables = [model.table for model in models.values() if model.table]
        labels = recipe.label_table or (trained.class_table if trained else ())
        groups |= draft_join(labels, tables, united)
    return groups


def _read_runs(models: Sequence[str | Path]) -> dict[str, EvaluatedRun]:
    """Read those of the models that are folders of runs, by their names."""
    known = {*METHODS, *list_bundled_models()}
    names = [str(name) for name in models if str(name) not in known]
    return {name: read_run(Path(name)) for name in names if Path(name).is_dir()}


def _open_models(
    options: EvaluationOptions, runs: Mapping[str, EvaluatedRun], stack: ExitStack
) -> dict[str, ScoredModel]:
    """Return the models by title, in the order of the arguments; the stack closes them."""
    names = list(dict.fromkeys(map(str, options.models)))
    files = {
        name: runs[name].model if name in runs else _find_file(name)
        for name in names
        if name not in METHODS
    }
    # A run is called like its folder: all have a model.pt.
    paths = [
        Path(name).resolve() if name in runs else files.get(name, Path(name)) for name in names
    ]
    left = list(options.adapters)
    scored: dict[str, ScoredModel] = {}
    for name, title in zip(names, short_names(paths), strict=True):
        if name in METHODS:
            scored[title] = open_method(name)
            continue
        opened = open_scored_model(
            files[name],
            device=options.device,
            threads=options.threads,
            size=options.size,
            adapters=left,
        )
        scored[title] = stack.enter_context(opened)
    if left:
        raise InputError(
            f"--adapter {left[0]}: every model has its own description: leave the adapter out"
        )
    answers = [open_predictions(text) for text in options.predictions]
    folders = short_names([folder for folder, _ in answers])
    for folder, (_, item) in zip(folders, answers, strict=True):
        scored[folder if folder not in scored else f"{folder} (predictions)"] = item
    return scored


def _find_file(name: str) -> Path:
    """Return the file of a model. Raises InputError, which also lists the methods."""
    try:
        return Path(name) if name.endswith(".pt") else find_model(name)
    except InputError as error:
        raise InputError(f"{error}; classical methods: {', '.join(METHODS)}") from error
