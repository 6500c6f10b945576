"""A video file, with a folder of depth maps beside it."""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InputError
from runtime.base.process_guard import SHARED_FILES, ProcessGuard
from runtime.files.read_input import require_regular
from runtime.geometry.assumptions import assume
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.images import DEPTH_SUFFIXES, list_files, require_pixels
from runtime.recordings.listing import ListedFrame
from runtime.recordings.orientation import check_turn
from runtime.recordings.source import files_by_number
from runtime.streams.frame import Frame

_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm")
_MOST_DAMAGED = 1000  # damaged frames in a row, after which the video has ended
# Else FFmpeg writes to the terminal, without a frame's name. OpenCV reads this at its first video.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class VideoSource(FolderSource):
    """The frames of a video, numbered from 0, and the depth maps with the same numbers.

    A frame's time stamp is its presentation time in the video.

    Args:
        path: a file that OpenCV's FFmpeg decodes.
        rig: the sensors of the car; its calibration is used.
        **options: `depth` and `depth_scale` of `FolderSource`; the names of depth maps end in the
            frame's number (7.png, depth_0007.png).

    Raises:
        InputError: if the video or the calibration cannot be read.
    """

    is_stream = True
    accepted = f"a video ({', '.join(_SUFFIXES)})"
    options = ("depth", "depth_scale")
    rig_options = ("calibration",)

    def __init__(self, path: Path, rig: Rig = DEFAULT_RIG, **options: Any) -> None:
        require_regular(path)
        super().__init__(path, rig, **options)
        self.recordings = (path,)
        self._guard = ProcessGuard("VideoSource", SHARED_FILES, InputError)
        self._video = _open(path)
        self._next = 0  # index of the frame that the video decodes next
        sides = (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)
        height, width = (int(self._video.get(side)) for side in sides)
        require_pixels((height, width), name=str(path))
        self._most: int | None = None  # number of frames to count; None: all
        self._decoded: NDArray[np.uint8] | None = None  # the frame that was decoded last
        self._has_repeats = False  # whether frames of the video are known to repeat others
        degrees = self._video.get(cv2.CAP_PROP_ORIENTATION_META) % 360
        shape = (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN)  # 0 = the header does not state it
        wide, high = (self._video.get(each) or 1.0 for each in shape)
        with self.collecting():
            check_turn(f"turns them by {degrees:.0f} degrees" if degrees else "", "video's header")
            if wide != high:
                assume(
                    f"pixels are used as they are stored, although the video's header makes them "
                    f"{wide / high:.3g} times as wide as high",
                    "give a calibration of the stored pixels, whose fx and fy then differ",
                )

    @staticmethod
    def accepts(path: Path) -> bool:
        """See `Source.accepts`."""
        return path.suffix.lower() in _SUFFIXES and os.path.isfile(path)

    def list_frames(self, *, limit: int | None = None) -> tuple[ListedFrame, ...]:
        """See `Source.list_frames`. The video is decoded to count its frames."""
        self._most = limit if self._depth is None else None
        return super().list_frames(limit=limit)

    def _list_images(self) -> Mapping[str, Any]:
        video, self._count, tried = _open(self._rgb, threads=0), 0, 0
        while self._count != self._most and tried - self._count < _MOST_DAMAGED:
            tried += 1
            if video.grab():
                self._count = tried
        stated = video.get(cv2.CAP_PROP_FRAME_COUNT)  # from header, or rate and duration
        video.release()
        if self._count == 0:
            raise InputError(f"{self._rgb} has no frame: it is empty, truncated or damaged")
        if self._most is None and 0 < stated != self._count:
            self._note(f"warning: {self._rgb} states {stated:.0f} frames, it has {self._count}")
        return {_name(number): number for number in range(self._count)}

    def _list_depths(self, folder: Path) -> dict[str, Path]:
        maps = files_by_number(list_files(folder, DEPTH_SUFFIXES))
        if self._count in maps and 0 not in maps:
            raise InputError(
                f"{maps[self._count]} is the depth of a frame beyond the {self._count} frames of "
                f"{self._rgb}, which are numbered from 0: so should be the maps (-start_number 0)"
            )
        return {_name(number): path for number, path in maps.items()}

    def read(self, frame: ListedFrame) -> Frame:
        """See `Source.read`. Raises InputError also if the image or the depth map is missing."""
        self._guard.check()
        read = super().read(frame)
        milliseconds = self._video.get(cv2.CAP_PROP_POS_MSEC)
        stamp_ns = round(milliseconds * 1e6) if math.isfinite(milliseconds) else None
        return replace(read, image=replace(read.image, stamp_ns=stamp_ns))

    def _read_image(self, image: Any) -> NDArray[np.uint8]:
        """Frame number `image`; to go back, the video is decoded again from its beginning."""
        if image < self._next:
            self._video.release()
            self._video, self._next, self._decoded = _open(self._rgb), 0, None
        decoded = _decode(self._video, image - self._next)
        self._next = image + 1
        if decoded is None:
            raise InputError(f"{self._rgb} ends before its frame {image}, or this frame is damaged")
        self._require_written(image, decoded)
        return np.ascontiguousarray(decoded[..., ::-1], dtype=np.uint8)

    def _require_written(self, image: int, decoded: NDArray[np.uint8]) -> None:
        """Raise InputError for a frame that OpenCV reports as decoded without writing its pixels.

        It does so where the conversion to RGB fails, as of interlaced frames: all pixels are 0, or
        those of the frame before. A second reader has no frame before.
        """
        before, self._decoded = self._decoded, decoded
        is_written = bool(decoded.any())
        is_repeated = before is not None and np.array_equal(decoded, before)
        if is_written and is_repeated and not self._has_repeats:
            again = _open(self._rgb)
            fresh = _decode(again, image)
            is_written = self._has_repeats = fresh is not None and np.array_equal(decoded, fresh)
            again.release()
        if not is_written:
            codec = int(self._video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")
            raise InputError(
                f"frame {image} of {self._rgb} (codec {codec.decode('latin-1')!r}) is black, or "
                "has no pixels: OpenCV cannot convert interlaced frames, ffmpeg -i VIDEO -vf yadif "
                "NEW can"
            )

    def close(self) -> None:
        """See `Source.close`."""
        self._video.release()


def _name(number: int) -> str:
    return f"{number:06d}"


def _decode(video: cv2.VideoCapture, skipped: int) -> NDArray[np.uint8] | None:
    """Return the frame after so many others, uint8 (H, W, 3) in BGR, or None."""
    for _ in range(skipped):
        video.grab()  # it also takes a frame that is damaged
    done, decoded = video.read()
    return np.asarray(decoded, np.uint8) if done and decoded is not None else None


def _open(path: Path, *, threads: int = 1) -> cv2.VideoCapture:
    """Open the video. Raises InputError if OpenCV cannot decode it.

    With `threads=1` it is decoded in the calling thread, whose priority is lower than that of
    inference; with 0 there are as many threads as cores.
    """
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
    if not video.isOpened():
        raise InputError(f"cannot read the video {path}: it is damaged, or OpenCV lacks its codec")
    # An orientation in the header is reported, but not applied, as for images.
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video
