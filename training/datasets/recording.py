"""A recording of a camera and a LiDAR, read as the engine reads it, and truth beside it."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import InputError
from runtime.geometry.motion import Scan
from runtime.recordings.images import KITTI_DEPTH_SCALE, list_files
from runtime.recordings.registry import detect_source, open_source, parse_source
from runtime.recordings.source import ListedFrame, Source
from runtime.streams.frame import Frame
from training.datasets.class_mapping import ClassTable
from training.datasets.files import dataset_errors, read_depth, require_size
from training.datasets.labels import Folder, LabelledRecipe, LabelReader
from training.datasets.sample import FrameList, Sample
from training.lidar.scan import elevation_bands, project_lines
from training.limits import STRICT, Index, Positive

# How the scan lines of returns are numbered: by the order of a scan's points, which KITTI's scanner
# sends line after line; by bands of elevation; or not at all.
Lines = Literal["ordered", "bands", "none"]
Targets = dict[str, NDArray[Any]]


class RecordedFrames(FrameList):
    """Frames that sources of the engine read; their returns are the depth target.

    A subclass adds the truth beside a recording in `_read_truth`.

    Args:
        frames: source, listed frame and name of each.
        lines: how scan lines are numbered.
        weights: see `Sample.weights`.
    """

    def __init__(
        self,
        frames: Iterable[tuple[Source, ListedFrame, str]],
        lines: Lines,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        self._frames = list(frames)
        self._lines, self._weights = lines, weights or {}
        listed = [frame.image for _, frame, _ in self._frames]
        self.images = [image for image in listed if isinstance(image, Path)]
        # See `Source.is_stream`.
        self.is_stream = any(source.is_stream for source, _, _ in self._frames)

    def _read_truth(self, listed: ListedFrame, size: tuple[int, int]) -> Targets:
        """Return targets of a frame of (height, width); depth replaces the returns as target."""
        return {}

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        source, listed, name = self._frames[index]
        frame = _read_named(source, listed)
        calibration, has_returns = frame.calibration, frame.depth is not None
        depth, scan_line = _returns(frame, self._lines)
        require_size(Path(str(listed.depth)), depth.shape, frame.size)
        truth = self._read_truth(listed, frame.size)
        return Sample(
            rgb=frame.rgb,
            targets={"depth": depth, **truth} if has_returns else truth,
            intrinsics=None if calibration is None else calibration.intrinsics,
            name=name,
            sparse_depth=depth if has_returns and "depth" in truth else None,
            scan_line=scan_line,
            weights=self._weights,
        )


def _read_named(source: Source, listed: ListedFrame) -> Frame:
    """Read a frame; an error names the file that it is about, or the file of the image."""
    try:
        return source.read(listed)
    except InputError as error:
        if any(str(place) in str(error) for place in (listed.image, listed.depth)):
            raise
        raise InputError(f"{listed.image}: {error}") from error


def _returns(frame: Frame, lines: Lines) -> tuple[NDArray[np.float32], NDArray[np.int16] | None]:
    """Return the returns of a frame in its image, and their scan lines if these are known."""
    calibration = frame.calibration
    if lines == "ordered" and frame.depth is not None and isinstance(frame.depth.data, Scan):
        assert calibration is not None  # it has projected the scan
        points = frame.depth.data.points
        return project_lines(points, calibration.intrinsics, calibration.extrinsics, frame.size)
    depth = frame.sparse_depth
    if lines != "bands":
        return depth, None
    return depth, elevation_bands(depth, None if calibration is None else calibration.intrinsics)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RecordingRecipe(LabelledRecipe):
    """Options of a recording in a recipe; `path` is a folder or a file.

    The paths of other files and folders are relative to `path` or, if it is a file, to its folder.

    Attributes:
        source: kind of the recording and its keys, KIND[,KEY=VALUE...] as in `--source` of
            `ssdnet-run`; None: the path tells the kind.
        depth: folder of depth maps of a folder of images.
        points: folder of scans of a folder of images.
        calibration: calibration of camera and LiDAR.
        poses: poses of the vehicle.
        frames: numbers in the source's list of the frames that are used; None: all that have
            returns or truth.
        truth: folder of 16-bit PNGs, named like the frames, with denser depth than the returns. It
            is the target, and the returns are the input. Without it some of the returns are the
            input and the others the target.
        truth_scale: units of `truth` per metre.
    """

    may_be_file: ClassVar[bool] = True

    kind: Literal["recording"] = "recording"
    source: Annotated[str, Field(min_length=1)] | None = None
    depth: Folder | None = None
    points: Folder | None = None
    calibration: Folder | None = None
    poses: Folder | None = None
    frames: tuple[Index, ...] | None = None
    truth: Folder | None = None
    truth_scale: Positive = KITTI_DEPTH_SCALE

    def open_source(self, path: Path) -> Source:
        """Open the recording at a path.

        Raises:
            InputError: as `runtime.recordings.registry.open_source`.
        """
        kind, _, keys = (self.source or "").partition(",")
        text = f"{kind}:{path}" + (f",{keys}" if keys else "")
        found = parse_source(text) if kind else detect_source(path)
        files = {name: getattr(self, name) for name in ("depth", "points", "poses")}
        given = {name: beside(path) / file for name, file in files.items() if file}
        rig = found.rig
        if self.calibration:
            rig = replace(rig, calibration=beside(path) / self.calibration)
        return open_source(found.kind, found.path, rig, **given, **found.keys)

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> "Recording":
        """See `SourceRecipe.open`."""
        return Recording(folder, self, classes)


class Recording(RecordedFrames):
    """The frames of a recording that have returns or truth, in the order of the recording.

    Raises:
        DatasetError: for a recording that cannot be opened or has no such frames.
    """

    def __init__(self, path: Path, recipe: RecordingRecipe, classes: ClassTable) -> None:
        source, base = recipe.open_source(path), beside(path)
        self._labels = LabelReader(recipe, classes)
        self._scale = recipe.truth_scale
        below = {"depth": recipe.truth, "semantic": recipe.labels}
        self._files = {
            name: list_files(base / folder, (".png",)) for name, folder in below.items() if folder
        }
        with_truth = {name for files in self._files.values() for name in files}
        chosen = None if recipe.frames is None else set(recipe.frames)
        frames = [
            frame
            for frame in source.list_frames()
            if frame.image is not None
            and (chosen is None or frame.sequence in chosen)
            and ((frame.complete and frame.depth is not None) or frame.name in with_truth)
        ]
        weights = {"semantic": recipe.semantic_weight}
        named = [
            (source, frame, f"{path.name}/{frame.name}") for frame in recipe.take(frames, path)
        ]
        super().__init__(named, "bands", weights)

    def _read_truth(self, listed: ListedFrame, size: tuple[int, int]) -> Targets:
        found = {name: files.get(listed.name) for name, files in self._files.items()}
        targets: Targets = {}
        if (path := found.get("depth")) is not None:
            targets["depth"] = read_depth(path, size, depth_scale=self._scale)
        if (path := found.get("semantic")) is not None:
            targets["semantic"] = self._labels.read(path, size)
        return targets


def beside(path: Path) -> Path:
    """Return the folder that the files beside a recording are relative to."""
    return path if path.is_dir() else path.parent
