"""A video file, with depth maps in a folder beside it."""

import math
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.io.images import (
    DEPTH_SUFFIXES,
    KITTI_DEPTH_SCALE,
    list_files,
    read_sparse_depth,
    require_pixels,
)
from runtime.read_input import require_regular
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source, by_number, no_depth, pair_up

_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm")


class VideoSource(Source):
    """The frames of a video, numbered from 0, and the depth maps with those numbers.

    A frame's time stamp is its presentation time in the video.

    Args:
        path: a file that OpenCV's FFmpeg decodes.
        depth: folder of depth maps, see `read_sparse_depth`, whose names end in the frame's number
            (7.png, depth_0007.png); None: the camera alone.
        depth_scale: units of 16-bit depth maps per metre.
        calibration: TOML or KITTI file, see `Calibration.from_file`.

    Raises:
        InputError: if the video or the calibration cannot be read.
    """

    accepted = f"a video ({', '.join(_SUFFIXES)})"

    def __init__(
        self,
        path: Path,
        *,
        depth: Path | None = None,
        depth_scale: float = KITTI_DEPTH_SCALE,
        calibration: Path | None = None,
    ) -> None:
        require_regular(path)
        self._path, self._depth, self._depth_scale = path, depth, depth_scale
        folder = Path(os.path.realpath(path)).parent
        self.folders = (folder,) if depth is None else (folder, depth)
        self.recordings = (path,)
        if calibration is not None:
            self.calibration = Calibration.from_file(calibration)
        self._video = _open(path)
        self._next = 0  # index of the next frame that the video decodes
        sides = (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)
        height, width = (int(self._video.get(side)) for side in sides)
        require_pixels((height, width), name=str(path))

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return path.suffix.lower() in _SUFFIXES and os.path.isfile(path)

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. A frame without a depth map is listed too, and the reverse."""
        count = int(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        if not 0 < count <= self._path.stat().st_size:
            raise InputError(
                f"{self._path} states no number of frames: it is empty, truncated or damaged, or a "
                "stream, which ffmpeg -i FILE -c copy NEW.mp4 makes a file"
            )
        maps = {}
        if self._depth is not None:
            maps = by_number(list_files(self._depth, DEPTH_SUFFIXES))
        if count in maps and 0 not in maps:
            raise InputError(
                f"{maps[count]} has the number {count}, but {self._path} has {count} frames, which "
                "are numbered from 0: number the depth maps from 0 (ffmpeg -start_number 0)"
            )
        numbers = sorted(set(range(count)) | maps.keys())
        digits = max(6, len(str(numbers[-1])))
        images = dict(zip(range(count), range(count), strict=True))
        depths = None if self._depth is None else maps
        return pair_up(numbers, images, depths, limit=limit, name=lambda n: f"{n:0{digits}d}")

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also where the image or depth map is missing."""
        if frame.image is None:
            raise InputError(f"{frame.name} has a depth map, but the video has no such frame")
        if frame.depth is None and self._depth is not None:
            raise InputError(f"{frame.name} is in the video, but has no depth map")
        rgb, stamp_ns = self._decode(frame.image)
        rgb, calibration = self._rectified(rgb, self.calibration, has_map=frame.depth is not None)
        sparse_depth = no_depth(rgb)
        if frame.depth is not None:
            sparse_depth = read_sparse_depth(frame.depth, depth_scale=self._depth_scale)
        return Frame(rgb, sparse_depth, stamp_ns, None, calibration)

    def _decode(self, number: int) -> tuple[NDArray[np.uint8], int | None]:
        """A frame, uint8 (H, W, 3), RGB, and its time [ns]."""
        if number < self._next:
            self._video.release()
            self._video, self._next = _open(self._path), 0
        while self._next < number and self._video.grab():
            self._next += 1
        done, image = self._video.read()
        if not done or self._next < number:
            raise InputError(
                f"{self._path} ends or is damaged before its frame {number}: earlier frames were "
                "read"
            )
        self._next += 1
        if image.dtype != np.uint8 or image.ndim != 3:
            raise InputError(f"{self._path} holds {image.dtype} images, expected 8-bit RGB")
        rgb = np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
        milliseconds = self._video.get(cv2.CAP_PROP_POS_MSEC)
        return rgb, round(milliseconds * 1e6) if math.isfinite(milliseconds) else None

    @property
    def inputs(self) -> dict[str, Any]:
        """See `Source.inputs`."""
        depth = None if self._depth is None else str(self._depth)
        return {"video": str(self._path), "depth": depth, "depth_scale": self._depth_scale}

    def close(self) -> None:
        """See `Source.close`."""
        self._video.release()


def _open(path: Path) -> cv2.VideoCapture:
    """The open video. Raises InputError unless OpenCV can decode it."""
    # Decode in the calling thread, whose priority is lower than that of inference.
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    if not video.isOpened():
        raise InputError(
            f"cannot read the video {path}: it is truncated, damaged, or of a format that OpenCV "
            "does not decode"
        )
    # As with images, pixels stay where the sensor has them.
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video
