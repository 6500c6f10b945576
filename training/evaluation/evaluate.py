"""Scores of every model on every set with every LiDAR and fault, and how the models differ."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path

from runtime.base.errors import ContractError, InputError
from runtime.contract.network_size import NetworkSize
from runtime.engine.bundled_models import find_model, list_bundled_models
from training.datasets.source_recipe import SourceRecipe
from training.evaluation.classical import METHODS
from training.evaluation.options import EvaluationOptions
from training.evaluation.scored_model import (
    ScoredModel,
    open_method,
    open_predictions,
    open_scored_model,
)
from training.lidar.faults import Fault
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset, spread_indices
from training.pages.worst_frames import WorstFrame, draw_worst
from training.run.finished_run import EvaluatedRun, read_run
from training.scores.differences import Difference, compare
from training.scores.metrics import FARTHEST_M
from training.scores.score_report import Row, format_differences, format_table
from training.scores.score_set import EvaluatedSet, Result, score_set
from training.scores.shared_classes import join_names, share_classes


@dataclass(frozen=True)
class Evaluation:
    """The result of `evaluate`.

    Attributes:
        results: a result for each model, set, LiDAR and fault. The sets are in their order, and in
            each set the models are in theirs.
        differences: differences of every model to the first, on each set with each input.
        worst: pictures of the frames with the largest errors.
    """

    results: Sequence[Result]
    differences: Sequence[Difference] = ()
    worst: Sequence[WorstFrame] = ()

    def __str__(self) -> str:
        """Return the tables that `ssdnet-eval` prints, with lines of any length."""
        return format_table(self.rows) + format_differences(self.differences)

    @property
    def rows(self) -> list[Row]:
        """The figures of each result."""
        return [result.row for result in self.results]

    @classmethod
    def of(
        cls,
        results: Sequence[Result],
        models: Mapping[str, ScoredModel],
        sets: Sequence[EvaluatedSet],
        *,
        draw: bool,
    ) -> "Evaluation":
        """Compare the results of open models on open sets, and draw the worst frames if asked."""
        worst = list(draw_worst(results, models, sets)) if draw else ()
        return cls(results, compare(results), worst)


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
    return score_models(
        EvaluationOptions(
            models=models,
            data=data,
            lidars=lidars,
            faults=faults,
            predictions=predictions,
            adapters=adapters,
            join=join,
            device=device,
            threads=threads,
            size=size,
            limit=limit,
            farthest_m=farthest_m,
        )
    )


def score_models(options: EvaluationOptions) -> Evaluation:
    """Score what the options name, see `evaluate`; for a page the worst frames are drawn.

    Raises OutputError if depth cannot be written, and the errors of `evaluate`.
    """
    runs = _read_runs(options.models)
    # The run whose validation sets are scored.
    own = None if options.sets else next(iter(runs.values()), None)
    sets = options.sets if own is None else own.sets
    if not sets:
        raise InputError(
            "no data to score on: give --data KIND:FOLDER, or the folder of a run whose recipe has "
            "validation sets"
        )
    feeds = options.feeds("own" if own is None else own.recipe.validation.lidar)
    with ExitStack() as stack:
        models = _open_models(options, runs, stack)
        opened = _open_sets(options, sets, own, models)
        results = [
            result
            for data in opened
            for name, model in models.items()
            for result in score_set(
                name,
                model,
                data,
                feeds,
                save=options.depth_folder,
                leave_out_fed=options.leave_out_fed,
            )
        ]
        if not results:
            raise InputError(
                "nothing could be scored: these sets provide none of the requested --lidar inputs "
                "(lines need intrinsics, or a recorded scan, every second line of which remains "
                "the target): use random:0.05 or none, which every set provides"
            )
        return Evaluation.of(results, models, opened, draw=options.page is not None)


def _read_runs(models: Sequence[str | Path]) -> dict[str, EvaluatedRun]:
    """Read those of the models that are folders of runs, by their names."""
    known = {*METHODS, *list_bundled_models()}
    names = [str(name) for name in models if str(name) not in known]
    return {name: read_run(Path(name)) for name in names if Path(name).is_dir()}


def _open_sets(
    options: EvaluationOptions,
    recipes: Sequence[SourceRecipe],
    run: EvaluatedRun | None,
    models: Mapping[str, ScoredModel],
) -> list[EvaluatedSet]:
    """Open sets with the classes that they share with the models.

    Args:
        options: what is asked of the sets.
        recipes: recipes of the sets.
        run: the run that has them for its validation; None if they were named.
        models: the models by name.
    """
    ids, farthest_m = None, FARTHEST_M
    if run is not None:
        ids, farthest_m = run.recipe.model.class_table, run.recipe.validation.farthest_m
    tables = {name: model.table for name, model in models.items() if model.table}
    own = [recipe.label_table or ids or () for recipe in recipes]
    joined = join_names(options.join or {}, [*own, *tables.values()])
    folders = short_names([Path(recipe.path) for recipe in recipes])
    opened = []
    for recipe, folder in zip(recipes, folders, strict=True):
        title = recipe.name or " ".join([folder, *_changed_keys(recipe)])
        classes = share_classes(recipe, title, tables, ids=ids, joined=joined)
        source = open_dataset(recipe, [Path()], classes=classes.table)
        indices = spread_indices(source, options.limit or len(source))
        opened.append(
            EvaluatedSet(title, source, classes, indices, options.farthest_m or farthest_m)
        )
    return opened


def short_names(paths: Sequence[Path]) -> list[str]:
    """Name paths by as few of their last parts as make the names unique."""
    longest = max((len(path.parts) for path in paths), default=1)
    for parts in range(1, 1 + max(1, longest)):
        names = [str(Path(*path.parts[-parts:])) for path in paths]
        if len(set(names)) == len(set(paths)):
            break
    return names


def _open_models(
    options: EvaluationOptions, runs: Mapping[str, EvaluatedRun], stack: ExitStack
) -> dict[str, ScoredModel]:
    """Return the models by title, in the order of the arguments; the stack closes them."""
    names = list(dict.fromkeys(map(str, options.models)))
    paths = {
        name: runs[name].model if name in runs else _find_file(name)
        for name in names
        if name not in METHODS
    }
    # A run is called like its folder: all have a model.pt.
    titled = [Path(name).resolve() if name in runs else path for name, path in paths.items()]
    titles = dict(zip(paths, short_names(titled), strict=True))
    left = list(options.adapters)
    scored: dict[str, ScoredModel] = {}
    for name in names:
        if name in METHODS:
            scored[name] = open_method(name)
            continue
        opened = open_scored_model(
            paths[name],
            device=options.device,
            threads=options.threads,
            size=options.size,
            adapters=left,
        )
        scored[titles[name]] = stack.enter_context(opened)
    if left:
        raise InputError(
            f"--adapter {left[0]}: every model has its own description: leave the adapter out"
        )
    answers = [open_predictions(text) for text in options.predictions]
    folders = short_names([item.recorded.folder for item in answers if item.recorded])
    for folder, item in zip(folders, answers, strict=True):
        scored[folder if folder not in scored else f"{folder} (predictions)"] = item
    return scored


def _find_file(name: str) -> Path:
    """Return the file of a model. Raises ContractError, which also lists the methods."""
    try:
        return Path(name) if name.endswith(".pt") else find_model(name)
    except ContractError as error:
        raise ContractError(f"{error}; classical methods: {', '.join(METHODS)}") from error


def _changed_keys(recipe: SourceRecipe) -> list[str]:
    """Return the keys in which this set differs from the same folder without options."""
    return [
        f"{item.name}={getattr(recipe, item.name)}"
        for item in fields(recipe)
        if item.name not in ("kind", "path") and getattr(recipe, item.name) != item.default
    ]
