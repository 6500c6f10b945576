"""Write the answers of a run, a frame's files all or none."""

import contextlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract import Contract
from runtime.drawing.overlay import Overlay
from runtime.errors import OutputError
from runtime.io.atomic_write import atomic_write
from runtime.io.ply import encode_ply
from runtime.prediction import Prediction
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.run.run_folder import CLOUD, KINDS, SUFFIXES, RunFolder
from runtime.sources.frames import Frame

#: Kind of answer that is one head's -> the field of `Prediction` that holds it.
HEADS = {
    "semantic": "semantic",
    "depth": "depth",
    "uncertainty": "depth_uncertainty",
    "boundary": "boundary",
}
#: Kind of answer -> the head it cannot do without.
NEEDED_HEADS = {**HEADS, CLOUD: "depth"}
DEPTH_PNG_SCALE = 256  # units a metre, as KITTI's
UINT16_MAX = 65535
DEPTH_PNG_MAX_M = UINT16_MAX / DEPTH_PNG_SCALE
# Writing shares the processor with inference: what a level or a filter more costs was measured.
_PNG_RUNS = (
    cv2.IMWRITE_PNG_COMPRESSION,
    1,
    cv2.IMWRITE_PNG_STRATEGY,
    cv2.IMWRITE_PNG_STRATEGY_RLE,
    cv2.IMWRITE_PNG_FILTER,
    cv2.IMWRITE_PNG_FILTER_NONE,
)
_PNG_STORED = (
    cv2.IMWRITE_PNG_COMPRESSION,
    0,
    cv2.IMWRITE_PNG_FILTER,
    cv2.IMWRITE_PNG_FILTER_NONE,
)
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 85)


class FrameWriter:
    """Write each frame's answers into a folder of `RunFolder`, one subfolder a kind.

    folder, names, overwrite: as `RunFolder` takes them
    kinds: which of SUFFIXES to write; a head that the model lacks is left out
    focal_length_px: for clouds of frames without a calibration, see `intrinsics_of`
    overlay: that draws; None = one of its own
    Raises OutputError if the folder cannot be used.
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
    ) -> None:
        self._classes, self._focal_length_px = contract.classes, focal_length_px
        self._overlay = overlay or Overlay(contract.classes, contract.max_depth_m)
        self._folder = RunFolder(folder, kinds=kinds, names=names, overwrite=overwrite)

    def write(self, name: str, frame: Frame, prediction: Prediction) -> None:
        """Write what was asked for of one frame: all of it, or, on an error, none.

        Raises OutputError, and InputError for a cloud where the camera is not known.
        """
        written: list[Path] = []
        self._folder.note(name)
        try:
            for kind, folder in self._folder.subfolders.items():
                path = folder / (name + SUFFIXES[kind])
                content = self._encode(kind, frame, prediction, path)
                if content is not None:
                    atomic_write(path, content)
                    written.append(path)
        except BaseException:
            for path in written:
                with contextlib.suppress(OSError):  # the first error is the one to tell
                    path.unlink(missing_ok=True)
            raise

    def _encode(
        self, kind: str, frame: Frame, prediction: Prediction, path: Path
    ) -> bytes | memoryview | None:
        if kind == CLOUD:
            intrinsics = intrinsics_of(frame, self._focal_length_px)
            return encode_ply(prediction.points(intrinsics, frame.rgb), self._classes)
        try:
            if kind == "overlay":
                return encode_overlay(self._overlay.draw(frame.rgb, prediction))
            values = getattr(prediction, HEADS[kind])
            return None if values is None else _ENCODERS[kind](values)
        except (cv2.error, ValueError) as error:
            height, width = frame.rgb.shape[:2]
            raise OutputError(
                f"cannot encode {path} of a frame of {height} x {width} ({error}): leave out "
                f"{kind} with --save"
            ) from error


def encode_semantic(semantic: NDArray[np.uint8]) -> memoryview:
    """PNG of class ids, 8 bits."""
    return encode(".png", semantic, _PNG_RUNS)


def encode_metres(metres: NDArray[np.float32]) -> memoryview:
    """PNG of 16 bits, metres x 256 rounded; what is beyond 255.99 m says 65535."""
    near = np.clip(metres, 0, DEPTH_PNG_MAX_M)
    units = np.rint(near * DEPTH_PNG_SCALE).astype(np.uint16)
    return encode(".png", units, _PNG_STORED)


def encode_boundary(boundary: NDArray[np.float32]) -> memoryview:
    """PNG of 8 bits, probability x 255 rounded."""
    return encode(".png", cv2.convertScaleAbs(boundary, alpha=255), _PNG_STORED)


def encode_overlay(picture: NDArray[np.uint8]) -> memoryview:
    """JPEG of what `Overlay` draws. Raises ValueError if the format cannot hold it."""
    return encode(".jpg", picture, _JPEG)


_ENCODERS: dict[str, Callable[[NDArray[Any]], memoryview]] = {
    "semantic": encode_semantic,
    "depth": encode_metres,
    "uncertainty": encode_metres,
    "boundary": encode_boundary,
}


def encode(suffix: str, image: Any, parameters: tuple[int, ...]) -> memoryview:
    """Encode an image, blue first, in memory. Raises ValueError if the format cannot hold it."""
    done, content = cv2.imencode(suffix, image, parameters)
    if not done:
        raise ValueError(f"{image.shape[0]} x {image.shape[1]} is too large for {suffix}")
    return content.ravel().data
