"""Adaptation of a network's depth to a camera and a LiDAR, from a recording of them without labels.

A part of the returns is the input, the others are the target. Only layers that the depth alone
reads are trained, so that classes and boundaries do not change. The models before and after the
training are scored on frames that were kept apart, and the better model is kept.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models import Network, load_checkpoint, save_checkpoint
from models.checkpoint import FINAL, LAST, RECIPE
from runtime.base.errors import InputError
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from training.base.stop_signal import Stop, StopRequested, never
from training.datasets.class_mapping import trained_classes
from training.datasets.recording import RecordingRecipe
from training.datasets.sample import Sample
from training.evaluation.classical import create_method
from training.evaluation.open_model import method_predict
from training.fine_tuning.adaptation_frames import find_frames
from training.lidar.simulate import SENSOR_LINES
from training.lidar.split import LidarInput, LidarSplit, split_lidar
from training.loading.open_dataset import Watched, open_dataset
from training.losses.terms import DEPTH_ALONE
from training.recipes.chosen_recipe import config_changes
from training.run.loop import train
from training.run.recipe import Recipe, build_recipe
from training.run.run_folder import folder_errors
from training.run.training_run import RunResult, TrainingRun
from training.scores.metrics import FARTHEST_M, frame_errors
from training.scores.scoring import Predict, torch_predict
from training.weights.initial_weights import Weights
from training.weights.release import mix_weights

Depth = NDArray[np.float32]

# In the folder of a run: the file of the chosen frames, and the folder of the training.
FRAMES, TRAINING = "frames.json", "training"
_STEPS, _WARMUP = 200, 20
# Share of the trained weights in the mean of the old and the trained model.
_BETWEEN = 0.5
# Largest relative change of the depth on the bundled recording; a model that changes more has
# forgotten other rigs.
MOST_CHANGE = 0.04


@dataclass(frozen=True)
class Adapted(RunResult):
    """The result of `adapt`; `lines` are the scores, and what was kept.

    Attributes:
        paid: whether the adapted model is better; otherwise `path` holds the model before.
    """

    paid: bool = False


def adapt(
    recording: RecordingRecipe, init: Weights, run: TrainingRun, changes: Sequence[str] = ()
) -> Adapted:
    """Adapt the depth of a network to the rig of a recording.

    The function writes to `run.out`: frames.json (the chosen frames), training/ (the run, see
    `train`) and model.pt. The same call resumes what was stopped.

    Args:
        recording: the recording, with images and returns.
        init: the network that is adapted.
        run: how the training runs; its data is the folder that holds the recording.
        changes: changes of the recipe, see `build_recipe`.

    Raises:
        InputError: if the network has no layers that the depth alone reads, if there are too few
            frames with returns, if the frames have different sizes or focal lengths, if the folder
            belongs to another or an older adaptation, and in the cases of `train`.
    """
    network = init.network
    if not network.depth_layers:
        raise InputError(
            f"{init.path}: has no layers that the depth alone reads, which could be adapted: give "
            "ssdnet-lite, ssdnet-nano, or weights that began with these"
        )
    (root,), out = run.data, run.out
    if (out / TRAINING / RECIPE).is_file() and not (out / FRAMES).is_file():
        raise InputError(
            f"{out}: belongs to an adaptation that an earlier release began and this one cannot "
            f"resume (no {FRAMES}): choose another --out"
        )
    with contextlib.suppress(StopRequested):
        height = init.facts.trained_height
        chosen = find_frames(recording, root, out / FRAMES, trained_height=height, stop=run.stop)
        return _adapt(chosen.of(recording), init, run, changes)
    return Adapted(out / TRAINING / LAST, stopped=True)


def _adapt(
    sets: tuple[RecordingRecipe, RecordingRecipe],
    init: Weights,
    run: TrainingRun,
    changes: Sequence[str],
) -> Adapted:
    """Train on the first set and choose between the weights. Raises StopRequested."""
    out, stop = run.out, run.stop
    network = init.network
    recipe = make_recipe(init, sets[0], changes)
    kept_apart = Watched(open_dataset(sets[1], run.data, classes=(), stop=stop), stop)
    samples = [kept_apart[index] for index in range(len(kept_apart))]
    # Before the long training, check that these frames can tell the models apart.
    linear = score(method_predict(create_method("linear")), samples, stop)
    if linear.keys() != FEEDS.keys():
        raise InputError(
            f"{sets[1].title}: the {len(samples)} frames kept apart have too few returns to be "
            "scored: give a longer recording"
        )
    found = train(recipe, replace(run, out=out / TRAINING, init=init))
    if found.stopped:
        return Adapted(found.path, stopped=True)
    trained = load_checkpoint(found.path)
    models = {
        "before": network,
        "between": mix_weights(network, trained.model, _BETWEEN),
        "after": trained.model,
    }
    scores = {"linear": linear}
    scores |= {name: score(torch_predict(model), samples, stop) for name, model in models.items()}
    # The mean over the feeds of MAE and of RMSE.
    figures = {name: np.mean(list(found.values()), axis=0)[:2] for name, found in scores.items()}
    ratio = {name: float((figures[name] / figures["before"]).mean()) for name in models}
    change = bundled_changes(network, {name: models[name] for name in ("between", "after")})
    allowed = ["before", *(name for name, share in change.items() if share <= MOST_CHANGE)]
    best = min(allowed, key=lambda name: ratio[name])  # ties keep the model before
    paid = best != "before"
    with folder_errors(out):
        facts = dict(trained.training) if paid else init.facts.to_dict()
        save_checkpoint(out / FINAL, models[best], training=facts)
    lines = [*_table(scores, len(samples)), "depth on the bundled recording, changed by:"]
    for name, share in change.items():
        note = "" if name in allowed else ", too much to be kept"
        lines.append(f"{name:8} {100 * share:.1f} %{note}")
    if paid:
        lines.append(f"kept: {best}, {100 * (ratio[best] - 1):+.1f} % in MAE and RMSE")
    else:
        lines.append("kept: the model before; the adaptation does not pay on the frames kept apart")
    return Adapted(out / FINAL, lines=lines, paid=paid)


def make_recipe(init: Weights, recording: RecordingRecipe, changes: Sequence[str] = ()) -> Recipe:
    """Return the recipe of the training; `changes` are those of `build_recipe`."""
    config, facts = init.network.config, init.facts
    model: dict[str, Any] = {"name": config.name, "config": config_changes(config)}
    table = trained_classes(config.classes, facts)
    if table:
        model["classes"] = table if isinstance(table, str) else [asdict(info) for info in table]
    if facts.trained_height:
        model["trained_height"] = facts.trained_height
    return build_recipe(
        {
            "terms": "a recording of the user's",
            "model": model,
            "data": {
                "source": [asdict(recording)],
                "batch_size": 4,
                "cache_gib": 1.0,
                "augment": {
                    "scale": [0.7, 1.5],
                    "lidar_missing": 0.0,
                    "lidar_random": 0.5,
                    "world_scale": [0.75, 1.33],
                },
            },
            "loss": {
                "weights": {**DEPTH_ALONE, "depth_uncertainty": 0.2},
                "depth_form": "metric",
                "depth_scales": "finest",
                "metric_l2": 0.02,
                "metric_log": 20.0,
            },
            "optimizer": {
                "learning_rate": 5e-4,
                "only": init.network.depth_layers,
                "frozen": init.network.shared_depth_layers,
            },
            "schedule": {"steps": _STEPS, "warmup_steps": _WARMUP},
            "loop": {"ema_decay": 0.97, "clip_norm": 20.0},
        },
        "the adaptation",
        changes,
    )


def score(
    predict: Predict, samples: Sequence[Sample], stop: Stop = never
) -> dict[str, NDArray[np.float64]]:
    """Return MAE, RMSE and median error [m] of the withheld returns, means over frames, per feed.

    Raises StopRequested once `stop` is True.
    """
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in FEEDS}
    for number, sample in enumerate(samples):
        for name, lidar in FEEDS.items():
            if stop():
                raise StopRequested
            split = split_fed(sample, lidar, number)
            if ((split.target > 0) & (split.target <= FARTHEST_M)).any():
                answer = predict(sample.rgb, split.fed, sample.focal_length_px).depth
                assert answer is not None
                found[name].append(frame_errors(answer, split.target))
    return {name: np.mean(figures, axis=0) for name, figures in found.items() if figures}


def split_fed(sample: Sample, lidar: LidarInput, number: int) -> LidarSplit:
    """Split the returns of the frame of a number; of two frames, the second lacks other lines."""
    rng = np.random.default_rng([number, round(1 / lidar.share) if lidar.share else 0])
    split = split_lidar(sample, lidar, rng, same_target=False, first_line=number)
    assert split is not None  # every scan has half of the lines
    return split


# Lines of a recording are bands of elevation: every second one is about every second line.
FEEDS = {
    "half of the returns": LidarInput("random", share=0.5),
    "every second line": LidarInput("lines", lines=SENSOR_LINES // 2),
    "a quarter": LidarInput("random", share=0.25),
}


def _table(scores: Mapping[str, Mapping[str, Any]], frames: int) -> Iterator[str]:
    yield f"withheld returns of {frames} frames kept apart, MAE / RMSE, median in mm:"
    yield f"{'fed':20}" + "".join(f"{name:>22}" for name in scores)
    for feed in FEEDS:
        rows = (1000 * found[feed] for found in scores.values() if feed in found)
        cells = (f"{mae:.0f} / {rmse:.0f}, {median:.0f}" for mae, rmse, median in rows)
        yield f"{feed:20}" + "".join(f"{cell:>22}" for cell in cells)


def bundled_changes(before: Network, models: Mapping[str, Network]) -> dict[str, float]:
    """Return each model's mean relative change of the depth on the engine's bundled recording."""

    def depths(network: Network) -> list[Depth]:
        predict = torch_predict(network)
        answers = (
            predict(frame.rgb, frame.sparse_depth, BUNDLED_FOCAL_LENGTH_PX).depth
            for frame in bundled_frames()
        )
        return [depth for depth in answers if depth is not None]

    old = depths(before)
    changes = {}
    for name, model in models.items():
        pairs = zip(depths(model), old, strict=True)
        changes[name] = float(np.mean([float(np.abs(new / was - 1).mean()) for new, was in pairs]))
    return changes
