"""A recording of a camera and a LiDAR, read as the engine reads it, and truth beside it."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from runtime.base.errors import InputError
from runtime.geometry.odometry import ODOMETRY
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.images import KITTI_DEPTH_SCALE, list_files
from runtime.recordings.listing import ListedFrame
from runtime.recordings.registry import detect_source, open_source
from runtime.recordings.source import Source
from runtime.streams.frame import Frame
from runtime.streams.messages import Depth
from training.base.limits import STRICT, Index, Positive
from training.datasets.class_mapping import ClassTable
from training.datasets.files import dataset_errors, measured, read_depth, require_size
from training.datasets.labels import Folder, LabelledRecipe
from training.datasets.sample import FrameList, Sample, nothing_known
from training.datasets.scan_lines import elevation_bands, project_lines

# How the scan lines of returns are numbered: by the order of a scan's points, which KITTI's scanner
# sends line after line; by bands of elevation; or not at all.
Lines = Literal["ordered", "bands", "none"]


# Reads the labels in a file for an image of (height, width).
LabelsOf = Callable[[Path, tuple[int, int]], NDArray[Any]]


class Truth(NamedTuple):
    """The labels of a target.

    Attributes:
        files: the files by the names of the source's frames; a frame without a file lacks them.
        read: reads the labels of a file.
    """

    files: Mapping[str, Path]
    read: LabelsOf


class SetFrame(NamedTuple):
    """A frame of a data set, which a source of the engine reads, and the truth beside it.

    Attributes:
        source: reads image and returns.
        listed: the frame in the list of the source.
        name: name of the set and the frame.
        truth: file and reader of each target's labels.
        facts: further attributes of the `Sample`.
    """

    source: Source
    listed: ListedFrame
    name: str
    truth: Mapping[str, tuple[Path, LabelsOf]]
    facts: Mapping[str, Any] = {}


def pair(
    source: Source, listed: Iterable[ListedFrame], name: str, truth: Mapping[str, Truth]
) -> list[SetFrame]:
    """Return frames of the set `name` with the files of their truth, by target."""
    frames = []
    for frame in listed:
        there = {
            target: (files[frame.name], read)
            for target, (files, read) in truth.items()
            if frame.name in files
        }
        frames.append(SetFrame(source, frame, f"{name}/{frame.name}", there))
    return frames


class RecordedFrames(FrameList):
    """Frames of recordings. Their returns are the input, and the target where truth has no depth.

    Args:
        frames: the frames.
        lines: how scan lines are numbered.
        semantic_weight: weight of the classes, see `Sample.weights`.
        lacking: see `Sample.lacking`.
        has_lidar: whether a frame without returns is one of a LiDAR that measured nothing, so that
            no input is simulated for it.

    Raises:
        DatasetError: when a frame is read, if one of its files is damaged or has another size.
    """

    _frames: Sequence[SetFrame]

    def __init__(
        self,
        frames: Iterable[SetFrame],
        lines: Lines = "none",
        *,
        semantic_weight: float | None = None,
        lacking: tuple[int, ...] = (),
        has_lidar: bool = False,
    ) -> None:
        self._frames = list(frames)
        self._lines, self._has_lidar, self._lacking = lines, has_lidar, lacking
        self._weights = {} if semantic_weight is None else {"semantic": semantic_weight}
        self.names = [frame.listed.name for frame in self._frames]
        listed = [frame.listed.image for frame in self._frames]
        self.images = [image for image in listed if isinstance(image, Path)]
        # See `Source.is_stream`.
        self.is_stream = any(frame.source.is_stream for frame in self._frames)

    @dataset_errors()
    def __getitem__(self, index: int) -> Sample:
        recorded = self._frames[index]
        frame, scan_line = _read_named(recorded.source, recorded.listed), None
        if frame.depth is not None:
            returns, scan_line = _returns(frame, self._lines)
            require_size(Path(str(recorded.listed.depth)), returns.shape, frame.size)
            frame = replace(frame, depth=Depth(returns, stamp_ns=frame.depth.stamp_ns))
        elif self._has_lidar:
            frame = replace(frame, depth=Depth(nothing_known(frame.size)))
        truth = {name: read(path, frame.size) for name, (path, read) in recorded.truth.items()}
        frame = replace(frame, poses=None, name=recorded.name)
        return Sample(frame, truth, scan_line, self._weights, self._lacking, **recorded.facts)


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
    if lines == "ordered" and (scan := frame.scan) is not None:
        assert calibration is not None  # it has projected the scan
        matrices = calibration.intrinsics, calibration.extrinsics
        return project_lines(scan.points, *matrices, frame.size)
    depth = measured(frame.sparse_depth)
    if lines != "bands":
        return depth, None
    return depth, elevation_bands(depth, None if calibration is None else calibration.intrinsics)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RecordingRecipe(LabelledRecipe):
    """Options of a recording in a recipe; `path` is a folder or a file.

    The paths of other files and folders are relative to `path` or, if it is a file, to its folder.

    Attributes:
        source: kind of the recording, as in `--source` of `ssdnet-run`; None: the path tells the
            kind.
        keys: values of the keys of `--source`.
        depth: folder of depth maps of a folder of images.
        points: folder of scans of a folder of images.
        calibration: calibration of camera and LiDAR.
        poses: poses of the vehicle, or "odometry", see `FolderOptions`.
        frames: numbers in the source's list of the frames that are used; None: all that have
            returns or truth.
        truth: folder of 16-bit PNGs, named like the frames, with denser depth than the returns. It
            is the target, and the returns are the input. Without it some of the returns are the
            input and the others the target.
        truth_scale: units of `truth` per metre.
    """

    states_camera: ClassVar[bool] = True
    may_be_file: ClassVar[bool] = True

    kind: Literal["recording"] = "recording"
    source: Annotated[str, Field(min_length=1)] | None = None
    keys: Mapping[str, bool | int | float | str] = Field(default_factory=dict)
    depth: Folder | None = None
    points: Folder | None = None
    calibration: Folder | None = None
    poses: Folder | None = None
    frames: tuple[Index, ...] | None = None
    truth: Folder | None = None
    truth_scale: Positive = KITTI_DEPTH_SCALE

    @property
    def folders(self) -> tuple[str, ...]:
        """See `SourceRecipe.folders`; what lies beside the recording, whether this is a file."""
        poses = None if self.poses == ODOMETRY else self.poses
        names = (self.depth, self.points, self.calibration, poses, self.truth, self.labels)
        places = (self.path, os.path.dirname(self.path))
        near = [os.path.join(place, name) for name in names if name for place in places]
        inside = os.path.join(os.path.normpath(self.path), "")
        found = [os.path.normpath(place) for place in near]
        return self.path, *dict.fromkeys(place for place in found if not place.startswith(inside))

    def open_source(self, path: Path) -> Source:
        """Open the recording at a path.

        Raises:
            InputError: as `runtime.recordings.registry.open_source`.
        """
        files = {name: getattr(self, name) for name in ("depth", "points", "poses", "calibration")}
        given: dict[str, Any] = {**self.keys}
        given |= {
            name: file if file == ODOMETRY else beside(path) / file
            for name, file in files.items()
            if file
        }
        of_rig = {each.name for each in fields(Rig)} & given.keys()
        rig = Rig(**{name: given.pop(name) for name in of_rig})
        return open_source(self.source or detect_source(path).kind, path, rig, **given)

    @dataset_errors()
    def open(self, folder: Path, classes: ClassTable) -> RecordedFrames:
        """Open the frames that have returns or truth, in the order of the recording.

        Raises:
            DatasetError: for a recording that cannot be opened or has no such frames.
        """
        source = self.open_source(folder)
        if isinstance(source, FolderSource):
            source.camera_alone = True
        truth = {
            target: Truth(list_files(beside(folder) / below, (".png",)), read)
            for target, below, read in (
                ("depth", self.truth, partial(read_depth, depth_scale=self.truth_scale)),
                ("semantic", self.labels, self.open_labels(classes).read),
            )
            if below is not None
        }
        with_truth = {name for files, _ in truth.values() for name in files}
        frames = [
            frame
            for frame in source.list_frames()
            if frame.image is not None
            and (self.frames is None or frame.sequence in self.frames)
            and ((frame.complete and frame.depth is not None) or frame.name in with_truth)
        ]
        paired = pair(source, self.take(frames, folder), folder.name, truth)
        weight, lacking = self.semantic_weight, self.lacking_ids(classes)
        return RecordedFrames(paired, "bands", semantic_weight=weight, lacking=lacking)


def beside(path: Path) -> Path:
    """Return the folder that the files beside a recording are relative to."""
    return path if path.is_dir() else path.parent
