"""Answers written by others, scored by the names of the frames without the network."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as checked

from runtime.base.errors import DatasetError
from runtime.files.read_input import read_input
from runtime.recordings.images import KITTI_DEPTH_SCALE
from training.base.limits import STRICT, Positive
from training.base.tables import build, parse_pairs
from training.datasets.class_mapping import ClassTable, TableName, named_table
from training.datasets.files import (
    dataset_errors,
    read_depth,
    read_gray,
    require_folder,
    require_size,
)
from training.datasets.sample import Sample
from training.scores.scoring import HeadMaps

_SUFFIXES = (".png", ".npy")
# Folders of a kind, as `ssdnet-run` writes them; without them the files show their kind.
_HEADS = ("semantic", "depth")


@checked(frozen=True, kw_only=True, config=STRICT)
class PredictionOptions:
    """Keys of `--predictions DIR,KEY=VALUE`.

    Attributes:
        classes: the meaning of the ids: a name in `models.CLASS_TABLES`, or the names in the order
            of the ids; None: those of the set.
        depth_scale: units of 16-bit PNGs and integers per metre.
    """

    classes: TableName | Annotated[tuple[str, ...], Field(min_length=1, max_length=255)] | None = (
        None
    )
    depth_scale: Positive = KITTI_DEPTH_SCALE


@dataclass(frozen=True)
class Predictions:
    """A folder of answers, a file per frame: PNGs of 8 bits (ids) or 16 bits (depth), or .npy.

    Attributes:
        folder: folder of the files, or of the folders "semantic" and "depth" with the files.
        options: the meaning of ids and depth.
    """

    folder: Path
    options: PredictionOptions
    # The frame for which each file was read.
    _frames: dict[Path, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> "Predictions":
        """Read DIR[,KEY=VALUE...]. Raises InputError, or DatasetError without such a folder."""
        folder, table = parse_pairs("--predictions", text, lambda _: PredictionOptions)
        options = build(PredictionOptions, table, f"--predictions {text!r}: ")
        return cls(require_folder(Path(folder), "a PNG or .npy file for every frame"), options)

    @property
    def table(self) -> ClassTable:
        """The classes of the ids; () stands for those of the set."""
        return named_table(self.options.classes or ())

    def read(self, sample: Sample, image_name: str | None) -> HeadMaps:
        """Return the answers to a frame.

        Args:
            sample: the frame.
            image_name: stem of its image; None if unknown.

        Raises:
            DatasetError: if there is no file of its name, or the file has another kind or size.
        """
        maps: dict[str, NDArray[np.generic]] = {}
        for head, files in self._files.items():
            if (path := _find(files, sample.name, image_name)) is None:
                name = image_name or sample.name
                raise DatasetError(
                    f"{self.folder}: has no {head or 'file'} of the frame {name} "
                    f"({' or '.join(f'{name}{suffix}' for suffix in _SUFFIXES)}); every frame that "
                    "is scored needs one: add it, or take the frame out of --data with first, last "
                    "or split"
                )
            if (frame := self._frames.setdefault(path, sample.name)) != sample.name:
                raise DatasetError(
                    f"{path}: is the file of two frames, {frame} and {sample.name}: put each into "
                    "a folder of the name before it"
                )
            values = self._read(path, sample, head)
            maps[head or ("semantic" if values.dtype == np.uint8 else "depth")] = values
        return HeadMaps(**maps)

    @cached_property
    def _files(self) -> Mapping[str, Mapping[str, Path]]:
        """For each head, or "" for files that show their kind: the files by name without suffix."""
        below = [head for head in _HEADS if (self.folder / head).is_dir()]
        found = {head: _list_files(self.folder / head) for head in below or [""]}
        if empty := [self.folder / head for head, files in found.items() if not files]:
            raise DatasetError(f"{empty[0]}: has no .png and no .npy files: add one for each frame")
        return found

    def _read(
        self, path: Path, sample: Sample, head: str
    ) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Read a file of `head`; of "", one of 16 bits or of floats is depth."""
        scale = self.options.depth_scale
        if path.suffix.lower() == ".npy":
            return _read_array(path, sample.size, scale, head)
        with dataset_errors():
            header = read_input(path)[:26]
        of_depth = len(header) == 26 and header[24:26] == b"\x10\x00"  # 16 bits, gray
        if head == "depth" or (of_depth and not head):
            return read_depth(path, sample.size, depth_scale=scale)
        return read_gray(path, np.uint8, sample.size)


def _list_files(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).with_suffix("").as_posix()
        if path.suffix.lower() in _SUFFIXES and found.setdefault(name, path) != path:
            raise DatasetError(
                f"{path}: is an answer to the frame of {found[name].name}, too: keep one of them"
            )
    return found


def _find(files: Mapping[str, Path], frame: str, image_name: str | None) -> Path | None:
    """Return the file with a frame's whole name, else its last parts, else its image's name."""
    parts = frame.split("/")
    names = ["/".join(parts[first:]) for first in range(len(parts))]
    names += [] if image_name is None else [image_name]
    return next((files[name] for name in names if name in files), None)


def _read_array(
    path: Path, size: tuple[int, int], depth_scale: float, head: str
) -> NDArray[np.uint8] | NDArray[np.float32]:
    with dataset_errors():
        content = io.BytesIO(read_input(path))
    try:
        values: NDArray[Any] = np.squeeze(np.lib.format.read_array(content, allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read ({error}): write it with numpy.save") from error
    require_size(path, values.shape, size)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise DatasetError(
            f"{path}: is {values.dtype} {values.shape}; expected a map (height, width) of integers "
            "(class ids) or of floats (depth in metres)"
        )
    if values.dtype.kind == "f":
        if head == "semantic":
            raise DatasetError(f"{path}: has floats; expected class ids: write integers")
        if not np.isfinite(values).all():
            raise DatasetError(f"{path}: has depth that is not finite: write 0 for no depth")
        return np.asarray(values, np.float32)
    if head == "depth":
        return np.asarray(values / depth_scale, np.float32)
    if values.min() < 0 or values.max() > 255:
        raise DatasetError(
            f"{path}: integers up to {values.max()}; expected class ids from 0 to 255: write depth "
            "as floats in metres"
        )
    return np.asarray(values, np.uint8)
