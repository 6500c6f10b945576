"""Write the files of each frame of a run: all files of a frame, or none."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import cv2

from runtime.errors import OutputError
from runtime.io.atomic_write import atomic_write
from runtime.io.encode import ENCODERS, encode_jpeg
from runtime.io.ply import encode_ply
from runtime.prediction import Prediction
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.run.outputs.output import OpenRun
from runtime.run.report_files import write_report
from runtime.run.run_folder import CLOUD, OVERLAY, SAVED_HEADS, SUFFIXES, RunFolder
from runtime.sources.frames import Frame


class FrameWriter:
    """Write the answers to each frame, one subfolder a kind; see `open_frame_files`.

    Args:
        folder: open, with a subfolder for each kind that is written.
        run: draws the overlays, and knows the classes and the focal length of clouds.
    """

    def __init__(self, folder: RunFolder, run: OpenRun) -> None:
        self._folder, self._run = folder, run

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Write the files of one frame: all of them, or, on an error, none.

        Raises OutputError, and InputError for a cloud where the camera is not known.
        """
        written: list[Path] = []
        self._folder.add_name(frame.name)
        try:
            for kind, folder in self._folder.subfolders.items():
                path = folder / (frame.name + SUFFIXES[kind])
                content = self._encode(kind, frame, prediction, path)
                if content is not None:
                    atomic_write(path, content)
                    written.append(path)
        except BaseException:
            for path in written:
                with contextlib.suppress(OSError):  # the first error is reported
                    path.unlink(missing_ok=True)
            raise

    def _encode(
        self, kind: str, frame: Frame, prediction: Prediction, path: Path
    ) -> bytes | memoryview | None:
        if kind == CLOUD:
            intrinsics = intrinsics_of(frame, self._run.predictor.focal_length_px)
            return encode_ply(
                prediction.points(intrinsics, frame.rgb), self._run.predictor.contract.classes
            )
        try:
            if kind == OVERLAY:
                widest = self._run.options.overlay_width
                return encode_jpeg(self._run.overlay.draw(frame.rgb, prediction, widest=widest))
            head, encoding = SAVED_HEADS[kind]
            values = prediction.heads.get(head)
            return None if values is None else ENCODERS[encoding](values)
        except (cv2.error, ValueError) as error:
            height, width = frame.rgb.shape[:2]
            raise OutputError(
                f"cannot encode {path} of a frame of {height} x {width} ({error}): leave out "
                f"{kind} with --save"
            ) from error


@contextlib.contextmanager
def open_frame_files(run: OpenRun) -> Iterator[FrameWriter | None]:
    """Make the folder of --out, with the files of --save and, when the block ends, the report.

    Yields None where no file of a frame is to be written.
    """
    options = run.options
    folder = RunFolder(
        options.folder, kinds=run.kinds, names=run.names, overwrite=options.overwrite
    )
    with contextlib.closing(folder):
        yield FrameWriter(folder, run) if run.kinds else None
    if run.report is not None:
        write_report(run.report)
