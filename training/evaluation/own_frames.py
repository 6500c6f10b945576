"""A user's frames in an evaluation: folders of images and labels, with the classes of a list."""

from collections.abc import Mapping, Sequence
from os.path import relpath
from typing import Any

from training.datasets.class_list import read_class_list, read_labels
from training.datasets.folders import FoldersRecipe
from training.evaluation.options import EvaluationOptions
from training.run.finished_run import EvaluatedRun


def own_frames(options: EvaluationOptions, run: EvaluatedRun | None) -> list[FoldersRecipe]:
    """Return the set of --images; [] without.

    Files of a frame have the same name in each folder. Without a list of classes, the labels have
    the meaning of a run's own.
    """
    if options.images is None:
        return []
    keys: dict[str, Any] = {}
    trained = [item for item in (run.sets if run else ()) if isinstance(item, FoldersRecipe)]
    if options.labels is not None and options.classes is not None:
        infos, keys = read_labels(options.classes, options.labels, palette=options.palette)
        keys = keys or {"label_ids": {index: info.name for index, info in enumerate(infos)}}
    elif trained:
        own = trained[0]
        keys = {key: getattr(own, key) for key in ("label_ids", "label_colors", "ignore")}
    images = options.images.resolve()
    for key, folder in (("labels", options.labels), ("depth", options.depth)):
        if folder is not None:
            keys[key] = relpath(folder.resolve(), images)
    keys |= {} if options.depth is None else {"scan": True}
    keys |= {} if options.depth_scale is None else {"depth_scale": options.depth_scale}
    name = "/".join(options.images.parts[-2:])
    return [FoldersRecipe(path=str(images), rgb=".", name=name, **keys)]


def united_classes(options: EvaluationOptions) -> Mapping[str, Sequence[str]]:
    """For the classes of --classes that unite others, return the names of these."""
    listed = () if options.classes is None else read_class_list(options.classes)
    return {item.name: item.relatives for item in listed if item.relatives}
