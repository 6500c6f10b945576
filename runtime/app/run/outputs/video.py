"""A video of the overlays of a run."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import cv2

from runtime.app.run.options import DEFAULT_RATE_HZ
from runtime.app.run.outputs.run_context import RunContext
from runtime.base.errors import OutputError
from runtime.files.atomic_write import atomic_path
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult

_CODEC = "mp4v"  # MPEG-4 part 2, which OpenCV's wheels encode on every system without licences
_LARGEST_SIDE = 4096  # pixels that players decode


class VideoWriter:
    """Appends the overlay of each frame to a video; see `open_video`."""

    def __init__(self, path: Path, run: RunContext) -> None:
        self._path, self._run = path, run
        self._file: cv2.VideoWriter | None = None
        self._size = (0, 0)
        self._frames = 0

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Draw a frame and append it, resized to the size of the first one. Raises OutputError."""
        picture = self._run.draw(frame, result, widest=frame.rgb.shape[1])
        if self._file is None:
            self._size = _video_size(*picture.shape[:2])
            codec, rate_hz = cv2.VideoWriter.fourcc(*_CODEC), self._run.options.rate
            settings = cv2.CAP_FFMPEG, codec, rate_hz or DEFAULT_RATE_HZ, self._size
            self._file = cv2.VideoWriter(str(self._path), *settings)
        self._file.write(cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA))
        self._frames += 1

    def finish(self) -> None:
        """Write the index. Raises OutputError if the file does not hold all frames."""
        if self._file is None:
            return
        self._file.release()
        self._file = None
        # The encoder reports neither errors nor a full disk.
        written = cv2.VideoCapture(str(self._path))
        frames = int(written.get(cv2.CAP_PROP_FRAME_COUNT))
        written.release()
        if frames != self._frames:
            raise OutputError(
                f"{self._path.name} holds {frames} of {self._frames} frames: free some space or "
                "choose another location"
            )


@contextlib.contextmanager
def open_video(run: RunContext) -> Iterator[VideoWriter]:
    """Make the video of --video at --rate; a run without any frame leaves no video."""
    assert run.options.video is not None
    with atomic_path(run.options.video, overwrite=run.options.overwrite) as temporary:
        writer = VideoWriter(temporary, run)
        yield writer
        writer.finish()


def _video_size(height: int, width: int) -> tuple[int, int]:
    """(Width, height) of the video: at most _LARGEST_SIDE, and even for chroma subsampling."""
    shrunk = min(1.0, _LARGEST_SIDE / max(height, width))
    return max(round(width * shrunk / 2) * 2, 2), max(round(height * shrunk / 2) * 2, 2)
