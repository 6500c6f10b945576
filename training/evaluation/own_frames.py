"""A user's frames in an evaluation: folders of images and labels, with the classes of a list."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path
from typing import Any

from runtime.base.errors import InputError
from training.base.palette import Palette
from training.datasets.class_list import read_class_list, read_labels
from training.datasets.folders import FoldersRecipe
from training.run.finished_run import EvaluatedRun


@dataclass(frozen=True)
class OwnFrames:
    """Folders of frames, whose files have the same names.

    Attributes:
        images: PNG or JPEG images.
        labels: PNGs of class ids or colours; None: none.
        classes: list of the classes of the labels; None: those of the evaluated run.
        palette: colours of the labels, see `read_labels`.
        depth: 16-bit PNGs of a LiDAR's depth; None: none.
        depth_scale: units of the depth per metre.
    """

    images: Path
    labels: Path | None = None
    classes: Path | None = None
    palette: Palette | None = None
    depth: Path | None = None
    depth_scale: float | None = None

    def __post_init__(self) -> None:
        """Check that the options go together."""
        for option, value, needed, given in (
            ("--classes", self.classes, "--labels", self.labels),
            ("--palette", self.palette, "--classes", self.classes),
            ("--depth-scale", self.depth_scale, "--depth", self.depth),
        ):
            if value is not None and given is None:
                raise InputError(f"{option} belongs to {needed}: give both, or neither")

    def recipe(self, run: EvaluatedRun | None) -> FoldersRecipe:
        """Return the set. Without a list of classes, the labels have the meaning of a run's own."""
        keys: dict[str, Any] = {}
        trained = [item for item in (run.sets if run else ()) if isinstance(item, FoldersRecipe)]
        if self.labels is not None and self.classes is not None:
            infos, keys = read_labels(self.classes, self.labels, palette=self.palette)
            keys = keys or {"label_ids": {index: info.name for index, info in enumerate(infos)}}
        elif trained:
            own = trained[0]
            keys = {key: getattr(own, key) for key in ("label_ids", "label_colors", "ignore")}
        images = self.images.resolve()
        for key, folder in (("labels", self.labels), ("depth", self.depth)):
            if folder is not None:
                keys[key] = relpath(folder.resolve(), images)
        keys |= {} if self.depth is None else {"scan": True}
        keys |= {} if self.depth_scale is None else {"depth_scale": self.depth_scale}
        name = "/".join(self.images.parts[-2:])
        return FoldersRecipe(path=str(images), rgb=".", name=name, **keys)

    @property
    def united(self) -> Mapping[str, Sequence[str]]:
        """For the classes of the list that unite others, the names of these."""
        listed = () if self.classes is None else read_class_list(self.classes)
        return {item.name: item.relatives for item in listed if item.relatives}
