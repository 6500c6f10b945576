"""Whether a network that was trained on one's own classes is better than the one it began with.

Both are scored on the frames kept apart, in the classes that both know, joined where one splits
what the other unites.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from models import Network, load_checkpoint, save_checkpoint
from models.checkpoint import FINAL
from training.base.stop_signal import Stop, never
from training.datasets.class_mapping import named_table
from training.datasets.class_names import join_relatives
from training.lidar.split import LidarInput
from training.loading.open_dataset import open_dataset
from training.run.network import build_network
from training.run.recipe import Recipe
from training.run.run_folder import folder_errors
from training.run.training_run import RunResult, TrainingRun
from training.scores.differences import compare
from training.scores.evaluated_set import EvaluatedSet
from training.scores.metrics import class_iou
from training.scores.score_set import Result, score_set
from training.scores.scored_model import open_network
from training.scores.shared_classes import ScoredClasses
from training.weights.initial_weights import Weights

# The trained network in the folder of a run whose model.pt is the one before.
TRAINED = "trained.pt"
# Loss of a class, in points of IoU, from which it is named.
_LOSS = 2.0


class Pair(NamedTuple):
    """The scores of the network before and of the trained one on the same frames."""

    before: Result
    after: Result


@dataclass(frozen=True)
class FineTuned(RunResult):
    """The result of `finetune`; `lines` are the scores, and what was kept.

    Attributes:
        paid: whether the trained network is not worse on the frames kept apart; otherwise `path`
            holds the network before, if that has all classes.
    """

    paid: bool = True


def score_both(
    recipe: Recipe, init: Weights, trained: Network, data: Sequence[Path], stop: Stop = never
) -> list[Pair]:
    """Score initial weights and a trained network on the validation set of a recipe.

    Returns one pair; none if the network has no class of the initial weights, if no frame has its
    label, or if the recipe has no validation set. Raises StopRequested once `stop` is True.
    """
    names = [info.name for info in init.network.config.classes]
    groups = join_relatives(recipe.model.relatives, names)
    if not (groups and recipe.validation.source):
        return []
    own, known = ["(new)"] * len(recipe.model.class_names), ["(left out)"] * len(names)
    titles = []
    for ids, of in groups:
        titles.append(" + ".join(recipe.model.class_names[index] for index in ids))
        for table, members in ((own, ids), (known, of)):
            for index in members:
                table[index] = titles[-1]
    (item,) = recipe.validation.source
    source = open_dataset(item, data, classes=recipe.model.class_table, stop=stop)
    classes = ScoredClasses(named_table(own), tuple(titles))
    frames = EvaluatedSet(item.title, source, classes, range(len(source)))
    feeds = [(LidarInput.parse(recipe.validation.lidar), "none")]
    before, after = (
        score_set(name, open_network(network, named_table(table)), frames, feeds)
        for name, network, table in (("before", init.network, known), ("after", trained, own))
    )
    return [Pair(before[0], after[0])] if "miou" in before[0].row.figures else []


def judge(pairs: Sequence[Pair], init: Weights) -> tuple[str, list[str]]:
    """Return the verdict on the mIoU of the trained network, and the scores in words.

    The frames of several pairs, which are of different trainings, count as one set.
    """
    before, after = (_pool([pair[side] for pair in pairs]) for side in range(2))
    (found,) = compare([before, after])
    iou = [
        100 * class_iou(np.sum([frame.confusion for frame in result.frames], axis=0))
        for result in (before, after)
    ]
    _, low, high = found.figures["miou"]
    verdict = found.verdict("miou")
    was, now = (float(np.nanmean(each)) for each in iou)
    lines = [
        f"mIoU of {len(before.classes)} classes on {before.row.frames} frames kept apart: "
        f"{init.path.stem}, joined: {was:.1f}; yours: {now:.1f} "
        f"({100 * low:+.1f} to {100 * high:+.1f}): {verdict}"
    ]
    losses = zip(before.classes, iou[1] - iou[0], strict=True)
    if worse := [f"{name} {change:+.1f}" for name, change in losses if change < -_LOSS]:
        lines.append(f"classes that became worse: {', '.join(worse)}")
    return verdict, lines


def _pool(results: Sequence[Result]) -> Result:
    """Join the results of one model on several sets."""
    frames = [frame for result in results for frame in result.frames]
    frames = [replace(frame, index=number) for number, frame in enumerate(frames)]
    row = replace(results[0].row, frames=len(frames))
    return replace(results[0], row=row, frames=frames)


def conclude(
    recipe: Recipe, run: TrainingRun, found: RunResult, pairs: Sequence[Pair] = ()
) -> RunResult:
    """Say whether a finished training pays, and keep the network before if it does not.

    Args:
        recipe: the recipe of the training.
        run: the run, with its initial weights.
        found: what it has made.
        pairs: scores of trainings on parts of the data; (): the recipe's validation set is scored.

    Raises StopRequested once `run` is stopped.
    """
    init = run.init
    if found.stopped or init is None or "semantic" not in init.network.heads:
        return found
    path = found.path.with_name(TRAINED)
    trained = load_checkpoint(path if path.is_file() else found.path)
    pairs = pairs or score_both(recipe, init, trained.model, run.data, run.stop)
    if not pairs:
        return FineTuned(found.path)
    verdict, lines = judge(pairs, init)
    if not recipe.validation.source:
        lines.append("the last training, on all frames, has no score of its own")
    is_worse = verdict == "worse"
    names = [info.name for info in init.network.config.classes]
    is_known = all(set(of) & set(names) for of in recipe.model.relatives)
    if verdict != "better":
        lines.append(
            "try more pictures, of other places; --folds 5, which scores on all of them; or more "
            "schedule.steps, or another optimizer.learning_rate"
        )
    if is_worse and is_known:
        lines.append(f"kept: the model before; the trained one is {path}")
        with folder_errors(run.out):
            save_checkpoint(path, trained.model, training=trained.training)
            start = build_network(recipe.model, init, resumed=True)
            facts = {**trained.training, "step": 0}
            save_checkpoint(run.out / FINAL, start.eval(), training=facts)
    elif path.is_file():
        save_checkpoint(run.out / FINAL, trained.model, training=trained.training)
    return FineTuned(found.path, lines=[*lines, str(found.path)], paid=not is_worse)
