"""Write the files of each frame of a run: all files of a frame, or none."""

import contextlib
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Self

import cv2

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.errors import OutputError
from runtime.io.atomic_write import atomic_write
from runtime.io.encode import ENCODERS, encode_jpeg
from runtime.io.ply import encode_ply
from runtime.prediction import Prediction
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.run.outputs.output import OpenRun
from runtime.run.report_files import write_report
from runtime.run.run_folder import CLOUD, KINDS, OVERLAY, SAVED_HEADS, SUFFIXES, RunFolder
from runtime.sources.frames import Frame


class FrameWriter:
    """Write the answers to each frame into a `RunFolder`, one subfolder a kind.

    Args:
        folder: see `RunFolder`.
        contract: of the model.
        kinds: of SUFFIXES; heads that the model lacks are left out.
        names: see `RunFolder`.
        overwrite: see `RunFolder`.
        focal_length_px: for clouds of frames without a calibration, see `intrinsics_of`.
        overlay: draws the overlays; None = a new one.
        overlay_width: largest width of a panel of an overlay; None = as `Overlay` has it.

    Raises:
        OutputError: if the folder cannot be used.
    """

    def __init__(
        self,
        folder: Path,
        contract: Contract,
        *,
        kinds: Sequence[str] = KINDS,
        names: Collection[str] = (),
        overwrite: bool = False,
        focal_length_px: float | None = None,
        overlay: Overlay | None = None,
        overlay_width: int | None = None,
    ) -> None:
        self._classes, self._focal_length_px = contract.classes, focal_length_px
        self._overlay = overlay or Overlay(contract.classes, contract.max_depth_m)
        self._overlay_width = overlay_width
        self._folder = RunFolder(folder, kinds=kinds, names=names, overwrite=overwrite)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._folder.close()

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
            intrinsics = intrinsics_of(frame, self._focal_length_px)
            return encode_ply(prediction.points(intrinsics, frame.rgb), self._classes)
        try:
            if kind == OVERLAY:
                return encode_jpeg(
                    self._overlay.draw(frame.rgb, prediction, widest=self._overlay_width)
                )
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
    writer = FrameWriter(
        run.options.folder,
        run.predictor.contract,
        kinds=run.kinds,
        names=run.names,
        overwrite=run.options.overwrite,
        focal_length_px=run.predictor.focal_length_px,
        overlay=run.overlay,
        overlay_width=run.options.overlay_width,
    )
    with writer:
        yield writer if run.kinds else None
    if run.report is not None:
        write_report(run.report)
