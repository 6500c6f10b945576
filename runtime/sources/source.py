"""The interface of every source of frames: it lists its frames and reads each of them."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import Scan
from runtime.geometry.poses import PoseTrack
from runtime.sync.frame import Frame, Message


@dataclass(frozen=True)
class ListedFrame:
    """A frame that a source has not read yet.

    Attributes:
        sequence: index in the source, from 0.
        name: of the frame and of its output files, unique in the source.
        image: where the source finds the image (a path, an index, ...), None without one.
        depth: the same of the depth.
        image_stamp_ns: time of the image by its sensor's clock [ns], None if unknown.
        depth_stamp_ns: the same of the depth.
        complete: whether it has both, the depth of its own, or all that the source is to read.
        reused: whether the depth is an older scan, because the image has none of its own.
        scan_time_ns: time of the middle of the scan, None if unknown.
    """

    sequence: int
    name: str
    image: Any
    depth: Any
    image_stamp_ns: int | None = None
    depth_stamp_ns: int | None = None
    complete: bool = True
    reused: bool = False
    scan_time_ns: int | None = None

    def measured(
        self,
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32] | Scan | None = None,
        *,
        calibration: Calibration | None = None,
        poses: PoseTrack | None = None,
    ) -> Frame:
        """Return the frame with what its sensors measured, the depth projected into the image.

        Args:
            rgb: uint8 (H, W, 3), RGB.
            depth: a depth map, float32 (H, W) in metres, 0 where there is no return; or a scan,
                which has no times where they are not known.
            calibration: of the camera, for a scan also of the LiDAR.
            poses: of the LiDAR, by which a scan is moved to the time of the image.

        Raises:
            InputError: if the calibration is of images of another size, which would silently
                falsify clouds and the focal length.
        """
        if calibration is not None:
            calibration.require_size(rgb.shape[:2])
        if isinstance(depth, Scan) and depth.times is None and poses is not None:
            depth = depth._replace(times=self.scan_time_ns)
        measured = None
        if depth is not None:
            measured = Message(self.depth_stamp_ns, self.depth_stamp_ns or 0, depth)
        image = Message(self.image_stamp_ns, self.image_stamp_ns or 0, rgb)
        frame = Frame(image, measured, self.reused, calibration, poses, self.name)
        _ = frame.in_time  # projected here, in the thread that reads
        return frame


class Source(ABC):
    """A stream of frames that can be listed and read again, by one thread at a time.

    Attributes:
        accepted: the paths that are of this kind, in words.
        options: names of its options, the keywords of its constructor.
        calibration: of the camera and, where there is one, the LiDAR; None if unknown.
        folders: folders that frames are read from; predictions must not be written there.
        recordings: files or whole folders that outputs must not replace or write into.
    """

    accepted: ClassVar[str]
    options: ClassVar[tuple[str, ...]] = ()
    calibration: Calibration | None = None
    folders: tuple[Path, ...] = ()
    recordings: tuple[Path, ...] = ()
    _rectify = False

    @abstractmethod
    def __init__(self, path: Path, **options: Any) -> None:
        """Open the recording.

        Args:
            path: file or folder.
            **options: those that `options` names.

        Raises:
            InputError: if it is no recording of this kind.
        """

    @classmethod
    def open_cameras(cls, path: Path, **options: Any) -> "dict[str, Source]":
        """Open a source for each camera that the options name.

        Args:
            path: file or folder.
            **options: as of the constructor; one of them may name several cameras.

        Returns:
            The sources by the names of the cameras' folders; "" = the only camera.

        Raises:
            InputError: as the constructor.
        """
        return {"": cls(path, **options)}

    @staticmethod
    @abstractmethod
    def accepts(path: Path) -> bool:
        """Whether a path looks like a recording of this kind; its files are not opened."""

    @abstractmethod
    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """List the frames in order.

        Args:
            limit: end the list with so many complete frames; None: list all.

        Raises:
            InputError: if the source has no frames or cannot be listed.
        """

    @abstractmethod
    def read(self, frame: ListedFrame) -> Frame:
        """Read a frame of the list; reading in the list's order is fastest.

        Raises:
            InputError: if the frame is damaged or incomplete; others can still be read.
        """

    def rectify_images(self) -> None:
        """Let `read` return images without distortion, with a calibration without a lens.

        Raises:
            InputError: if the calibration has no lens.
        """
        if self.calibration is None or self.calibration.lens_model is None:
            reason = "calibration" if self.calibration is None else "lens in their calibration"
            raise InputError(f"the images cannot be rectified: there is no {reason}")
        self._rectify = True

    def _rectified(
        self, rgb: NDArray[np.uint8], calibration: Calibration | None, *, has_map: bool
    ) -> tuple[NDArray[np.uint8], Calibration | None]:
        """The image of a frame and its calibration, rectified after `rectify_images`.

        has_map: whether the frame has a depth map, of the distorted image, which raises InputError.
        """
        if not self._rectify or calibration is None:
            return rgb, calibration
        if has_map:
            raise InputError("a depth map lies on the pixels of the distorted image: no --rectify")
        return calibration.rectify(rgb), calibration.rectified

    @property
    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """The inputs as in report.json; after listing, also the counts of skipped messages."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines for the terminal: guesses and, after listing, the skipped messages."""
        return ()

    def close(self) -> None:  # noqa: B027 - most hold nothing open
        """Close open files. May be called again."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def up_to(frames: Iterable[ListedFrame], limit: int | None) -> tuple[ListedFrame, ...]:
    """The frames up to the `limit`-th complete one."""
    listed: list[ListedFrame] = []
    complete = 0
    for frame in frames:
        listed.append(frame)
        complete += frame.complete
        if complete == limit:
            break
    return tuple(listed)


def pair_up(
    names: Iterable[str],
    images: Mapping[str, Any],
    depths: Mapping[str, Any] | None,
    *,
    limit: int | None,
) -> tuple[ListedFrame, ...]:
    """List a frame for each name, complete with an image and, unless `depths` is None, depth."""
    found = depths or {}
    frames = (
        ListedFrame(
            sequence,
            name,
            images.get(name),
            found.get(name),
            complete=name in images and (depths is None or name in depths),
        )
        for sequence, name in enumerate(names)
    )
    return up_to(frames, limit)


def by_number(files: Mapping[str, Path]) -> dict[int, Path]:
    """Number at the end of the stem -> file. Raises InputError."""
    numbers: dict[int, Path] = {}
    for stem, path in files.items():
        digits = re.search("[0-9]+$", stem)
        if digits is None:
            raise InputError(f"the name of {path} must end in the number of its frame, from 0 on")
        number = int(digits[0])
        if number in numbers:
            raise InputError(f"{numbers[number]} and {path} have the same number: remove one")
        numbers[number] = path
    return numbers
