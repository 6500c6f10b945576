"""The gate of a quantised file: how much accuracy each head may lose."""

from collections.abc import Collection, Iterator, Mapping, Sequence

from export.accuracy import LEAST_CLASS_FRAMES, LEAST_CLASS_PIXELS, Accuracy, Widths
from export.options import ExportOptions
from runtime import InputError

# Limits without an option: loss of a class's IoU [points], loss of boundary F (0..1), and change of
# the share of errors within one scale of the uncertainty [points].
MAX_DROP_CLASS_IOU, MAX_DROP_BOUNDARY_F, MAX_CHANGE_COVERAGE = 3.0, 0.01, 3.0
# The figure of each head in `Accuracy`.
_FIGURES = {
    "semantic": "miou",
    "semantic_logits": "miou",
    "depth": "mae_m",
    "boundary": "boundary_f",
    "depth_uncertainty": "coverage_1",
}
# The ground truth that a set needs to measure each head, and example sets.
_NEEDED = {
    "semantic": (
        "labels of the model's classes",
        "folders:DIR,labels=FOLDER, camvid:DIR, cityscapes:DIR, kitti-streets:DIR",
    ),
    "depth": ("depth", "folders:DIR,depth=FOLDER, kitti-depth:DIR, kitti-streets:DIR"),
}


def find_missed(
    before: Sequence[Accuracy],
    after: Sequence[Accuracy],
    options: ExportOptions,
    widths: Widths | None = None,
) -> dict[str, str]:
    """Return the largest loss, in words, of each head that misses the gate; worst head first."""
    excess: dict[str, tuple[float, str]] = {}
    for first, second in zip(before, after, strict=True):
        where = f"on {first.data}, LiDAR {first.lidar}"
        wider = (widths or {}).get((first.data, first.lidar), {})
        for head, loss, most, words in _losses(first, second, options, wider):
            found = loss / max(most, 1e-9), f"{words} {where} (at most {most:.3g})"
            excess[head] = max(excess.get(head, found), found)
    worst_first = sorted(excess.items(), key=lambda entry: -entry[1][0])
    return {head: text for head, (ratio, text) in worst_first if ratio > 1}


def _losses(
    before: Accuracy, after: Accuracy, options: ExportOptions, wider: Mapping[str, float]
) -> Iterator[tuple[str, float, float, str]]:
    """Yield head, loss, its limit, and the loss in words, for the figures measured in both.

    `wider` is added to the limits of its figures.
    """
    if before.miou is not None and after.miou is not None:
        drop = 100 * (before.miou - after.miou)
        most = options.max_drop_miou + 100 * wider.get("miou", 0.0)
        yield "semantic", drop, most, f"semantic loses {drop:.2f} points of mIoU"
    for name, iou in before.class_iou.items():
        drop = 100 * (iou - after.class_iou[name])
        words = f"semantic loses {drop:.2f} points of the IoU of {name}"
        yield "semantic", drop, MAX_DROP_CLASS_IOU, words
    if before.boundary_f is not None and after.boundary_f is not None:
        drop = before.boundary_f - after.boundary_f
        yield "boundary", drop, MAX_DROP_BOUNDARY_F, f"boundary loses {drop:.4f} of F"
    if before.mae_m is not None and after.mae_m is not None:
        rise = 100 * (after.mae_m / max(before.mae_m, 1e-9) - 1)
        most = options.max_rise_mae + 100 * wider.get("mae_m", 0.0) / max(before.mae_m, 1e-9)
        yield "depth", rise, most, f"depth's MAE rises by {rise:.2f} %"
    if before.coverage_1 is not None and after.coverage_1 is not None:
        change = 100 * abs(before.coverage_1 - after.coverage_1)
        words = f"the share of errors within depth_uncertainty changes by {change:.2f} points"
        yield "depth_uncertainty", change, MAX_CHANGE_COVERAGE, words


def require_truth(heads: Collection[str], rows: Sequence[Accuracy]) -> None:
    """Raise InputError for a head whose accuracy no set can measure."""
    for head, (truth, sets) in _NEEDED.items():
        if head in heads and not _measured(head, rows):
            raise InputError(
                f"--validate: no set has {truth}, so the loss of the {head} head by int8 cannot be "
                f"measured, and nothing was written: add one of {sets}"
            )


def _measured(head: str, rows: Sequence[Accuracy]) -> bool:
    return any(getattr(row, _FIGURES.get(head, ""), None) is not None for row in rows)


def list_not_gated(
    heads: Sequence[str], classes: Sequence[str], rows: Sequence[Accuracy]
) -> list[str]:
    """Describe what cannot be measured on these sets."""
    found = [
        f"{head}: no set has ground truth for it" for head in heads if not _measured(head, rows)
    ]
    compared = {name for row in rows for name in row.class_iou}
    if rare := [name for name in classes if "semantic" in heads and name not in compared]:
        found.append(
            f"IoU of {', '.join(rare)}: fewer than {LEAST_CLASS_PIXELS} labelled pixels or "
            f"{LEAST_CLASS_FRAMES} frames"
        )
    return found
