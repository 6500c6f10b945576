"""The functions of `training` for Python; the commands that train call them, too.

Weights are given by the name of a checkpoint of the package ("ssdnet-lite"), or by the path of a
.pt file. Changes of a recipe are texts like "schedule.steps = 500", as with `ssdnet-train --set`.
"""

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from models import load_checkpoint
from models.checkpoint import LAST
from training.base.palette import Palette
from training.base.stop_signal import Stop, StopRequested, never
from training.evaluation.evaluate import evaluate as evaluate
from training.fine_tuning import adaptation
from training.fine_tuning.adaptation import Adapted
from training.fine_tuning.adaptation_frames import describe_recording
from training.fine_tuning.own_folders import RECIPE_TEXT, OwnFolders, keep_recipe, write_toml
from training.fine_tuning.verdict import FineTuned as FineTuned
from training.fine_tuning.verdict import Pair, conclude, score_both
from training.recipes.chosen_recipe import inherit_settings, read_stages
from training.run.dry_run import dry_run as draw_first_batch
from training.run.recipe import Recipe, build_recipe
from training.run.stages import Stage, train_stages
from training.run.training_run import RunResult, TrainingRun
from training.weights.initial_weights import Weights, find_weights, read_weights


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
    stop: Stop = never,
    dry_run: bool = False,
) -> RunResult:
    """Train a network with a recipe; an `out` of the same recipe is resumed.

    `training.run.loop.train` and `training.run.stages.train_stages` describe what is written to
    `out`.

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

    Returns:
        The checkpoint `out`/model.pt, or the last.pt of a run that was stopped. A dry run returns
        the picture batch.png, and the description of the data as `lines`.

    Raises:
        InputError: if the recipe is unknown, a key or value is wrong, or `out` belongs to another
            recipe.
        DatasetError: if a data set is missing or damaged.
        CheckpointError: if weights cannot be read or do not fit.
        NonFiniteLossError: if the loss or its gradient is NaN or infinite.
    """
    begin = None if init is None else _read_weights(init)
    run = TrainingRun(
        [Path(data)] if isinstance(data, str | Path) else [Path(folder) for folder in data],
        Path(out),
        init=begin,
        teacher=None if teacher is None else _read_weights(teacher),
        device=device,
        stop_after=stop_after,
        stop=stop,
    )
    stages = read_stages(str(recipe), changes, begin)
    return draw_first_batch(stages, run) if dry_run else train_stages(stages, run)


def finetune(
    images: str | Path,
    *,
    out: str | Path,
    labels: str | Path | None = None,
    classes: str | Path | None = None,
    ignore: Sequence[str] = (),
    palette: Palette | None = None,
    depth: str | Path | None = None,
    depth_scale: float | None = None,
    focal_length_px: float | None = None,
    intrinsics: tuple[float, float, float, float] | None = None,
    points: str | Path | None = None,
    calibration: str | Path | None = None,
    init: str | Path = "ssdnet-lite",
    changes: Sequence[str] = (),
    device: str = "cpu",
    folds: int = 0,
    stop_after: int | None = None,
    stop: Stop = never,
    dry_run: bool = False,
) -> RunResult:
    """Train the classes or the depth of a network on your own folders.

    A recipe is made for the folders, shown on stderr and written to `out`/recipe.toml. With labels
    the last layers of the classes are trained, otherwise those that only the depth reads. Files of
    a frame have the same name in each folder. Classes are compared with those of `init` at the end;
    if they became worse and `init` has all of them, `out`/model.pt is the network before.

    Args:
        images: PNG or JPEG images, at least 10. A tenth, at least six, is for validation: blocks of
            neighbours from three places. Or a recording of `ssdnet-run`, such as a bag, whose
            frames with labels are used.
        out: folder of the run.
        labels: 8-bit PNGs of class ids (0, 1, ...; 255 = none).
        classes: text file with the name of one class per line, in order of the ids; a line may
            also have the colour of the class in the labels, see `training.datasets.class_list`.
        ignore: classes of that file that are not learned: their pixels count as unlabelled.
        palette: colours of the labels: PASCAL VOC's in the order of the ids ("voc"), or those of
            Cityscapes, CamVid or Virtual KITTI by the names of the classes.
        depth: 16-bit PNGs of a LiDAR's depth, 0 = none.
        depth_scale: units of the depth per metre; None = 256.
        focal_length_px: focal length of the images as they are, with the principal point in their
            middle. Distances are then scaled if the camera differs from that of the weights, see
            `runtime.contract.canonical_focal`. None: not known.
        intrinsics: fx, fy, cx, cy [px], in place of the focal length.
        points: scans in place of depth maps, which are projected with the calibration.
        calibration: calibration of camera and LiDAR.
        init: weights to start from.
        changes: changes of the recipe, see `train`.
        device: "cpu", "cuda" or "cuda:N".
        folds: cut the images into so many blocks of neighbours, and train as often without one of
            them, which is scored; then train on all images, without a score. 0: one validation.
        stop_after: stop at this step.
        stop: called between two steps; True stops the run, which can be resumed.
        dry_run: see `train`.

    Returns:
        As `train`.

    Raises:
        InputError: if there are neither labels nor depth, if there are too few images, if only one
            of classes and labels is given, and for the reasons of `train`.
        DatasetError, CheckpointError, NonFiniteLossError: see `train`.
    """
    begin = _read_weights(init)
    own = OwnFolders(
        Path(images),
        labels=_path(labels),
        depth=_path(depth),
        classes=_path(classes),
        ignore=ignore,
        palette=palette,
        depth_scale=depth_scale,
        focal_length_px=focal_length_px,
        intrinsics=intrinsics,
        points=_path(points),
        calibration=_path(calibration),
    )
    run = TrainingRun(
        [own.root], Path(out), init=begin, device=device, stop_after=stop_after, stop=stop
    )
    table = own.make_recipe(begin, folds=folds)
    tqdm.write(write_toml(table, changes, own.root), file=sys.stderr)

    def build(table: Mapping[str, Any]) -> Recipe:
        return build_recipe(inherit_settings(table, changes, begin), RECIPE_TEXT)

    recipe = build(table)
    # Also in a dry run, because it is the file to edit.
    keep_recipe(table, changes, own.root, run.out)
    if dry_run:
        return draw_first_batch((Stage("", recipe),), run)
    pairs: list[Pair] = []
    with suppress(StopRequested):
        for fold in range(folds):
            part = replace(run, out=run.out / f"fold-{fold + 1}")
            # The same steps as the last training, which has all frames.
            scored = replace(build(own.make_recipe(begin, fold, folds)), schedule=recipe.schedule)
            found = train_stages((Stage("", scored),), part)
            if found.stopped:
                return found
            trained = load_checkpoint(found.path).model
            pairs += score_both(scored, begin, trained, part.data, stop)
        return conclude(recipe, run, train_stages((Stage("", recipe),), run), pairs)
    return RunResult(run.out / LAST, stopped=True)


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
    stop: Stop = never,
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
    run = TrainingRun([root], Path(out), init=begin, device=device, stop=stop)
    return adaptation.adapt(described, begin, run, changes)


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)


def _read_weights(name: str | Path) -> Weights:
    return read_weights(find_weights(str(name)))
