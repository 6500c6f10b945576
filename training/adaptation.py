"""Adaptation of a network's depth to a camera and a LiDAR, from a recording of them without labels.

A part of the returns is the input, the others are the target. Only layers that the depth alone
reads are trained, so that classes and boundaries do not change. The models before and after the
training are scored on frames that were kept apart, and the better model is kept.
"""

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from models import Network, load_checkpoint, save_checkpoint
from runtime.app.encode import encode_metres, encode_png
from runtime.base.errors import InputError
from runtime.contract.network_size import network_size
from runtime.contract.resize import move_returns, resize_image
from runtime.files.own_folder import atomic_folder
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from runtime.recordings.images import read_rgb
from runtime.recordings.registry import SOURCES, detect_source, open_source, parse_source
from runtime.recordings.source import ListedFrame, Source
from training.chosen_recipe import config_changes
from training.datasets.folders import FoldersRecipe
from training.datasets.sample import Sample
from training.evaluation.classical import create_method
from training.evaluation.metrics import FARTHEST_M, frame_errors
from training.evaluation.scored_model import method_predict, trained_classes
from training.evaluation.scoring import Predict, torch_predict
from training.initial_weights import Weights
from training.lidar.split import SENSOR_LINES, OcclusionFilter, is_kept, masked, random_share
from training.loading.open_dataset import open_dataset
from training.loop import train
from training.losses.terms import DEPTH_ALONE
from training.recipe import Recipe, build_recipe
from training.release import mix_weights
from training.run_folder import FINAL, LAST, folder_errors
from training.stop_signal import StopRequested

Depth = NDArray[np.float32]

# Folders inside the folder of a run: the frames of the recording, and the training.
FRAMES, TRAINING = "recording", "training"
# Largest number of frames that are read, and their least number.
MOST_FRAMES, LEAST_FRAMES = 600, 5
# Least number of returns within the range of scores of a frame that is used.
LEAST_RETURNS = 20
_KINDS = ("images", "lidar")
# Share of the time of the frames with returns, at its end, that is kept apart.
KEPT_APART = 0.1
_STEPS, _WARMUP = 200, 20
# Share of the trained weights in the mean of the old and the trained model.
_BETWEEN = 0.5
# Largest relative change of the depth on the bundled recording; a model that changes more has
# forgotten other rigs.
MOST_CHANGE = 0.04


@dataclass(frozen=True)
class Adapted:
    """The result of `adapt`.

    Attributes:
        path: the checkpoint, `RUN/model.pt`; if the training was stopped, its last.pt.
        lines: the scores, and what was kept, for the terminal.
        paid: whether the adapted model is better; otherwise `path` holds the model before.
    """

    path: Path
    lines: Sequence[str] = ()
    paid: bool = False


def adapt(
    source: Source,
    init: Weights,
    out: Path,
    *,
    changes: Sequence[str] = (),
    device: str = "cpu",
    stop: Callable[[], bool] = lambda: False,
) -> Adapted:
    """Adapt the depth of a network to the rig of a recording.

    The function writes to `out`: recording/ (the chosen frames as PNGs), training/ (the run, see
    `train`) and model.pt. The same call resumes what was stopped.

    Args:
        source: the recording, with images and returns.
        init: the network that is adapted.
        out: folder of the run.
        changes: changes of the recipe, see `build_recipe`.
        device: "cpu", "cuda" or "cuda:N".
        stop: called between two steps; True stops.

    Raises:
        InputError: if the network has no layers that the depth alone reads, if there are too few
            frames with returns, if the frames have different sizes or focal lengths, and in the
            cases of `train`.
    """
    network = init.network
    if not network.depth_layers:
        raise InputError(
            f"{init.path}: has no layers that the depth alone reads, which could be adapted: give "
            "ssdnet-lite, ssdnet-nano, or weights that began with these"
        )
    frames = out / FRAMES
    with contextlib.suppress(StopRequested):
        if frames.is_dir():
            tqdm.write(f"{frames}: the frames of an earlier start are taken", file=sys.stderr)
        else:
            _write_frames(source, frames, init.facts.trained_height, stop)
        return _adapt(init, out, frames, changes, device, stop)
    return Adapted(out / TRAINING / LAST)


def _adapt(
    init: Weights,
    out: Path,
    frames: Path,
    changes: Sequence[str],
    device: str,
    stop: Callable[[], bool],
) -> Adapted:
    """Train on the frames and choose between the weights. Raises StopRequested."""
    network = init.network
    focal_px = float((frames / "focal_length_px.txt").read_text()) or None
    recipe = make_recipe(init, frames, focal_px, changes)
    kept_apart = open_dataset(_frames_of("kept_apart", frames, focal_px), [out], classes=())
    samples = [kept_apart[index] for index in range(len(kept_apart))]
    # Before the long training, check that these frames can tell the models apart.
    linear = score(method_predict(create_method("linear")), samples, stop)
    if linear.keys() != FEEDS.keys():
        raise InputError(
            f"{frames}: the {len(samples)} frames kept apart have too few returns to be scored: "
            "give a longer recording"
        )
    path = train(recipe, data=[out], out=out / TRAINING, init=init, device=device, stop=stop)
    if path.name != FINAL:
        return Adapted(path)
    trained = load_checkpoint(path)
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
    change = {name: bundled_change(network, models[name]) for name in ("between", "after")}
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
    return Adapted(out / FINAL, lines, paid)


def is_named(recording: str) -> bool:
    """Return whether a text names the kind of a recording, KIND:PATH[,KEY=VALUE...]."""
    return recording.partition(":")[0] in SOURCES


def open_recording(recording: str, calibration: Path | None = None, **files: Path | None) -> Source:
    """Open a recording, a path or KIND:PATH[,KEY=VALUE...], with files that go with it.

    Raises InputError as `runtime.recordings.registry.open_source`.
    """
    found = parse_source(recording) if is_named(recording) else detect_source(Path(recording))
    rig = found.rig if calibration is None else replace(found.rig, calibration=calibration)
    return open_source(found.kind, found.path, rig, **files, **found.keys)


def choose_frames(listed: Sequence[ListedFrame]) -> list[tuple[ListedFrame, float]]:
    """Choose frames at equal distances of time, each with its time, 0 to 1.

    If there are no stamps, the order of the frames is the time. InputError for too few frames with
    depth.
    """
    found = [frame for frame in listed if frame.complete and frame.depth is not None]
    if len(found) < LEAST_FRAMES:
        raise InputError(
            f"the recording has {len(found)} frames with a scan or depth; expected at least "
            f"{LEAST_FRAMES}: for a folder of images give --points and --calibration, or --depth"
        )
    stamped = all(frame.image_stamp_ns is not None for frame in found)
    times = np.array([frame.image_stamp_ns if stamped else i for i, frame in enumerate(found)])
    times = (times - times[0]) / max(1, times[-1] - times[0])
    chosen = np.arange(len(found))
    if len(found) > MOST_FRAMES:
        wanted = np.linspace(0, 1, MOST_FRAMES)
        chosen = np.unique(np.searchsorted(times, wanted).clip(0, len(found) - 1))
    return [(found[i], float(times[i])) for i in chosen]


def _write_frames(
    source: Source, folder: Path, trained_height: int | None, stop: Callable[[], bool]
) -> None:
    """Write the chosen frames with returns at the size at which the network runs, all or none.

    The last share of their time is kept apart.
    """
    sizes: set[tuple[int, int]] = set()
    focals: set[float] = set()
    written: list[tuple[str, float]] = []
    empty = 0
    with folder_errors(folder), atomic_folder(folder) as made:
        for part in ("train", "kept_apart"):
            for kind in _KINDS:
                (made / part / kind).mkdir(parents=True)
        for listed, time in tqdm(choose_frames(source.list_frames()), desc="frames", disable=None):
            if stop():
                raise StopRequested
            try:
                frame = source.read(listed)
            except InputError as error:
                tqdm.write(f"left out: {error}", file=sys.stderr)
                continue
            whole = (frame.rgb.shape[0], frame.rgb.shape[1])
            size = network_size(None, whole, trained_height=trained_height)
            focal_px = frame.calibration.focal_length_px if frame.calibration else 0.0
            focals.add(round(focal_px * size[1] / whole[1], 2))
            sizes.add(size)
            name = f"{listed.sequence:06d}.png"
            returns = frame.sparse_depth
            if size != whole:
                returns = move_returns(returns, size)
            if np.count_nonzero((returns > 0) & (returns <= FARTHEST_M)) < LEAST_RETURNS:
                empty += 1
                continue
            picture = cv2.cvtColor(resize_image(frame.rgb, size), cv2.COLOR_RGB2BGR)
            (made / "train" / "images" / name).write_bytes(encode_png(np.asarray(picture)))
            (made / "train" / "lidar" / name).write_bytes(encode_metres(returns))
            written.append((name, time))
        if empty:
            text = f"left out: {empty} frames with fewer than {LEAST_RETURNS} returns"
            tqdm.write(text, file=sys.stderr)
        if empty and not written:
            raise InputError(
                "no frame has returns in the image: check the extrinsics of the calibration, or "
                "/tf_static of a bag; the camera looks along z"
            )
        if len(written) < LEAST_FRAMES:
            raise InputError(
                f"{len(written)} frames could be read and have returns; expected at least "
                f"{LEAST_FRAMES}: give a longer recording"
            )
        begin, end = written[0][1], written[-1][1]
        from_time = end - KEPT_APART * (end - begin)
        apart = [name for name, time in written if time > from_time] or [written[-1][0]]
        for name in apart:
            for kind in _KINDS:
                (made / "train" / kind / name).rename(made / "kept_apart" / kind / name)
        if len(sizes) > 1 or (focals and max(focals) > 1.01 * min(focals)):
            raise InputError(
                f"the frames have {len(sizes)} sizes and {len(focals)} focal lengths; expected one "
                "camera: adapt to one camera at a time"
            )
        (made / "focal_length_px.txt").write_text(f"{max(focals, default=0.0)}")


def _frames_of(part: str, frames: Path, focal_px: float | None) -> FoldersRecipe:
    """Return the data set of a part of the frames, whose returns are input and target."""
    first = next((frames / part / "images").glob("*.png"), None)
    if first is None:
        raise InputError(f"{frames / part}: none of the frames could be read")
    height, width = read_rgb(first).shape[:2]
    intrinsics = (focal_px, focal_px, width / 2, height / 2) if focal_px else None
    return FoldersRecipe(
        path=f"{FRAMES}/{part}",
        rgb="images",
        depth="lidar",
        scan=True,
        intrinsics=intrinsics,
    )


def make_recipe(
    init: Weights, frames: Path, focal_px: float | None, changes: Sequence[str] = ()
) -> Recipe:
    """Return the recipe of the training; `changes` are those of `build_recipe`."""
    config, facts = init.network.config, init.facts
    model: dict[str, Any] = {"name": config.name, "config": config_changes(config)}
    table = trained_classes(config.classes, facts.to_dict())
    if table:
        model["classes"] = table if isinstance(table, str) else [asdict(info) for info in table]
    if facts.trained_height:
        model["trained_height"] = facts.trained_height
    return build_recipe(
        {
            "terms": "a recording of the user's",
            "model": model,
            "data": {
                "source": [asdict(_frames_of("train", frames, focal_px))],
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
    predict: Predict, samples: Sequence[Sample], stop: Callable[[], bool] = lambda: False
) -> dict[str, NDArray[np.float64]]:
    """Return MAE, RMSE and median error [m] of the withheld returns, means over frames, per feed.

    Raises StopRequested once `stop` is True.
    """
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in FEEDS}
    for number, sample in enumerate(samples):
        for name, feed in FEEDS.items():
            if stop():
                raise StopRequested
            fed = feed(sample, number)
            truth = OcclusionFilter().apply(masked(sample.depth, fed == 0), sample.depth)
            if ((truth > 0) & (truth <= FARTHEST_M)).any():
                answer = predict(sample.rgb, fed, sample.focal_length_px).depth
                assert answer is not None
                found[name].append(frame_errors(answer, truth))
    return {name: np.mean(figures, axis=0) for name, figures in found.items() if figures}


def _some(share: float) -> Callable[[Sample, int], Depth]:
    return lambda sample, number: random_share(
        sample.depth, share, np.random.default_rng([number, round(1 / share)])
    )


def every_second_line(sample: Sample, number: int) -> Depth:
    """Keep every second band of elevation: about every second line of a scan."""
    assert sample.scan_line is not None
    return masked(sample.depth, is_kept(sample.scan_line + number, SENSOR_LINES // 2))


FEEDS: Mapping[str, Callable[[Sample, int], Depth]] = {
    "half of the returns": _some(0.5),
    "every second line": every_second_line,
    "a quarter": _some(0.25),
}


def _table(scores: Mapping[str, Mapping[str, Any]], frames: int) -> Iterator[str]:
    yield f"withheld returns of {frames} frames kept apart, MAE / RMSE, median in mm:"
    yield f"{'fed':20}" + "".join(f"{name:>22}" for name in scores)
    for feed in FEEDS:
        rows = (1000 * found[feed] for found in scores.values() if feed in found)
        cells = (f"{mae:.0f} / {rmse:.0f}, {median:.0f}" for mae, rmse, median in rows)
        yield f"{feed:20}" + "".join(f"{cell:>22}" for cell in cells)


def bundled_change(before: Network, after: Network) -> float:
    """Return the mean relative change of the depth on the recording installed with the engine."""
    predicts, changes = (torch_predict(before), torch_predict(after)), []
    for frame in bundled_frames():
        old, new = (
            predict(frame.rgb, frame.sparse_depth, BUNDLED_FOCAL_LENGTH_PX).depth
            for predict in predicts
        )
        assert old is not None
        assert new is not None
        changes.append(float(np.abs(new / old - 1).mean()))
    return float(np.mean(changes))
