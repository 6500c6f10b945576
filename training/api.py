"""The functions that train, for Python; the commands call them, too.

Weights are given by the name of a checkpoint of the package ("ssdnet-lite"), or by the path of a
.pt file. Changes of a recipe are texts like "schedule.steps = 500", as with `ssdnet-train --set`.
"""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

from training import adaptation
from training.adaptation import Adapted
from training.adaptation_frames import describe_recording
from training.chosen_recipe import fine_tune, read_stages
from training.dry_run import dry_run as dry_run_of
from training.initial_weights import Weights, find_weights, read_weights
from training.own_folders import RECIPE_TEXT, OwnFolders, keep_recipe
from training.recipe import build_recipe
from training.stages import Stage, next_stage, train_stages


def _never() -> bool:
    return False


def train(
    recipe: str | Path,
    *,
    data: str | Path | Sequence[str | Path],
    out: str | Path,
    init: str | Path | None = None,
    teacher: str | Path | None = None,
    changes: Sequence[str] = (),
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = _never,
    dry_run: bool = False,
    report: Callable[[str], None] = print,
) -> Path:
    """Train a network with a recipe; an `out` of the same recipe is resumed.

    `training.loop.train` and `training.stages.train_stages` describe what is written to `out`.

    Args:
        recipe: the name of a recipe of the package, or the path of a TOML file.
        data: folder with the recipe's data sets, or several such folders.
        out: folder of the run.
        init: weights to start from. Settings that a TOML file leaves out come from their training.
        teacher: weights whose answers are learned beside the labels.
        changes: changes of the recipe, in all of its stages.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step, counted over all stages.
        stop: called between two steps; True stops the run, which can be resumed.
        dry_run: do not train, but check that the next stage can start, describe its data, and draw
            its first batch.
        report: called with each line of the description of a dry run.

    Returns:
        The checkpoint `out`/model.pt; the last.pt of a run that was stopped; the picture batch.png
        of a dry run.

    Raises:
        InputError: if the recipe is unknown, a key or value is wrong, or `out` belongs to another
            recipe.
        DatasetError: if a data set is missing or damaged.
        CheckpointError: if weights cannot be read or do not fit.
        NonFiniteLossError: if the loss or its gradient is NaN or infinite.
    """
    begin = None if init is None else _read_weights(init)
    taught_by = None if teacher is None else _read_weights(teacher)
    stages = read_stages(str(recipe), changes, begin)
    folders = [Path(data)] if isinstance(data, str | Path) else [Path(folder) for folder in data]
    if dry_run:
        return _draw_first_batch(stages, folders, Path(out), begin, taught_by, device, report)
    return train_stages(
        stages,
        data=folders,
        out=Path(out),
        init=begin,
        teacher=taught_by,
        device=device,
        stop_after=stop_after,
        stop=stop,
    )


def finetune(
    images: str | Path,
    *,
    out: str | Path,
    labels: str | Path | None = None,
    classes: str | Path | None = None,
    ignore: Sequence[str] = (),
    depth: str | Path | None = None,
    depth_scale: float | None = None,
    focal_length_px: float | None = None,
    intrinsics: tuple[float, float, float, float] | None = None,
    init: str | Path = "ssdnet-lite",
    changes: Sequence[str] = (),
    device: str = "cpu",
    stop_after: int | None = None,
    stop: Callable[[], bool] = _never,
    dry_run: bool = False,
    report: Callable[[str], None] = print,
) -> Path:
    """Train the classes or the depth of a network on your own folders.

    A recipe is made for the folders and written to `out`/recipe.toml. With labels the last layers
    of the classes are trained, otherwise those that only the depth reads. Files of a frame have the
    same name in each folder.

    Args:
        images: PNG or JPEG images, at least 10. The last tenth, by name, is for validation.
        out: folder of the run.
        labels: 8-bit PNGs of class ids (0, 1, ...; 255 = none).
        classes: text file with the name of one class per line, in order of the ids.
        ignore: classes of that file that are not learned: their pixels count as unlabelled.
        depth: 16-bit PNGs of a LiDAR's depth, 0 = none.
        depth_scale: units of the depth per metre; None = 256.
        focal_length_px: focal length of the images as they are. Distances are then scaled if the
            camera differs from that of the weights, see `runtime.contract.canonical_focal`. None:
            not known.
        intrinsics: fx, fy, cx, cy [px], in place of the focal length.
        init: weights to start from.
        changes: changes of the recipe, see `train`.
        device: "cpu", "cuda" or "cuda:N".
        stop_after: stop at this step.
        stop: called between two steps; True stops the run, which can be resumed.
        dry_run: do not train.
        report: called with the recipe, and with each line of the description of a dry run.

    Returns:
        As `train`.

    Raises:
        InputError: if there are neither labels nor depth, if there are too few images, if only one
            of classes and labels is given, and for the reasons of `train`.
        DatasetError, CheckpointError, NonFiniteLossError: see `train`.
    """
    begin, target = _read_weights(init), Path(out)
    own = OwnFolders(
        Path(images),
        labels=_path(labels),
        depth=_path(depth),
        classes=_path(classes),
        ignore=ignore,
        depth_scale=depth_scale,
        focal_length_px=focal_length_px,
        intrinsics=intrinsics,
    )
    text = own.make_recipe(begin)
    report(text)
    table = fine_tune(tomllib.loads(text), changes, begin)
    stages = (Stage("", build_recipe(table, target / RECIPE_TEXT)),)
    keep_recipe(text, target)  # also in a dry run, because it is the file to edit
    if dry_run:
        return _draw_first_batch(stages, [own.root], target, begin, None, device, report)
    return train_stages(
        stages,
        data=[own.root],
        out=target,
        init=begin,
        device=device,
        stop_after=stop_after,
        stop=stop,
    )


def adapt(
    recording: str | Path,
    *,
    out: str | Path,
    depth: str | Path | None = None,
    points: str | Path | None = None,
    calibration: str | Path | None = None,
    poses: str | Path | None = None,
    init: str | Path = "ssdnet-lite",
    changes: Sequence[str] = (),
    device: str = "cpu",
    stop: Callable[[], bool] = _never,
) -> Adapted:
    """Adapt the depth of a network to a camera and a LiDAR, by a recording without labels.

    Only layers that the depth alone reads are trained, on returns that are not part of the input.
    The model before, the model after and the mean of both are scored on frames that were kept
    apart; the best becomes `out`/model.pt. The same call resumes a run that was stopped.

    Args:
        recording: a path, or KIND:PATH[,KEY=VALUE...] like `--source` of `ssdnet-run`.
        out: folder of the run.
        depth: depth maps of a folder of images.
        points: scans of a folder of images.
        calibration: calibration of camera and LiDAR.
        poses: poses of the vehicle.
        init: weights to adapt.
        changes: changes of the recipe, see `train`.
        device: "cpu", "cuda" or "cuda:N".
        stop: called between two steps; True stops the run.

    Returns:
        The checkpoint, the scores as lines of text, and whether the adaptation pays.

    Raises:
        InputError: for a recording that cannot be read or has too few frames with returns, frames
            of different sizes or focal lengths, or weights without layers that the depth alone
            reads; and as in `train`, like the other errors.
    """
    begin = _read_weights(init)
    files = {"depth": depth, "points": points, "calibration": calibration, "poses": poses}
    described, root = describe_recording(str(recording), **files)
    return adaptation.adapt(
        described, root, begin, Path(out), changes=changes, device=device, stop=stop
    )


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)


def _read_weights(name: str | Path) -> Weights:
    return read_weights(find_weights(str(name)))


def _draw_first_batch(
    stages: Sequence[Stage],
    data: Sequence[Path],
    out: Path,
    init: Weights | None,
    teacher: Weights | None,
    device: str,
    report: Callable[[str], None],
) -> Path:
    """Draw the first batch of the next stage and report what its data hold."""
    stage, folder, init = next_stage(stages, out, init, data)
    path, lines = dry_run_of(
        stage.recipe, data=data, out=folder, init=init, teacher=teacher, device=device
    )
    for line in lines:
        report(line)
    return path
