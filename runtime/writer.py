"""Write the answers of a run: files whole or not at all, in a folder known to be ours."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract import Contract
from runtime.errors import OutputError
from runtime.overlay import Overlay
from runtime.prediction import Prediction

KINDS = ("semantic", "depth", "boundary", "overlay")
DEPTH_PNG_SCALE = 256  # units a metre, as KITTI's
UINT16_MAX = 65535
FRAMES_FILE, REPORT_FILE, LATENCY_FILE = "frames.csv", "report.json", "latency.png"
_MARKER = ".ssdnet-run"
_MARKER_TEXT = b"Made by ssdnet-run, which may replace its own files here when told --overwrite.\n"
_SUFFIX = {"semantic": ".png", "depth": ".png", "boundary": ".png", "overlay": ".jpg"}
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
    """Write each frame's answers into `folder`, one subfolder a kind.

    folder: is made. One that exists must be empty, or, with `overwrite`, made by an earlier run,
        whose own files are then removed and nothing else.
    kinds: which of KINDS to write; a head that the model lacks is left out
    Raises OutputError if the folder cannot be had.
    """

    def __init__(
        self, folder: Path, contract: Contract, *, kinds: Iterable[str], overwrite: bool = False
    ) -> None:
        self.folder = folder
        self._kinds = tuple(kinds)
        self._overlay = Overlay(contract.classes, contract.max_depth_m)
        try:
            _prepare(folder, overwrite=overwrite)
            for kind in self._kinds:
                (folder / kind).mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot make the output folder {folder} ({error.strerror}): choose another --out"
            ) from error

    def write(self, name: str, rgb: NDArray[np.uint8], prediction: Prediction) -> None:
        """Write what was asked for of one frame: all of it, or, on an error, none.

        Raises OutputError.
        """
        written: list[Path] = []
        try:
            for kind in self._kinds:
                content = self._encode(kind, rgb, prediction)
                if content is not None:
                    path = self.folder / kind / (name + _SUFFIX[kind])
                    write_whole(path, content)
                    written.append(path)
        except BaseException:
            for path in written:
                path.unlink(missing_ok=True)
            raise

    def _encode(
        self, kind: str, rgb: NDArray[np.uint8], prediction: Prediction
    ) -> memoryview | None:
        if kind == "overlay":
            return encode(".jpg", self._overlay.draw(rgb, prediction), _JPEG)
        values = getattr(prediction, kind)
        return None if values is None else _ENCODERS[kind](values)


def encode_semantic(semantic: NDArray[np.uint8]) -> memoryview:
    """PNG of class ids, 8 bits."""
    return encode(".png", semantic, _PNG_RUNS)


def encode_depth(depth: NDArray[np.float32]) -> memoryview:
    """PNG of 16 bits, metres x 256 rounded; beyond 255.99 m clipped."""
    near = np.clip(depth, 0, UINT16_MAX / DEPTH_PNG_SCALE)
    units = np.rint(near * DEPTH_PNG_SCALE).astype(np.uint16)
    return encode(".png", units, _PNG_STORED)


def encode_boundary(boundary: NDArray[np.float32]) -> memoryview:
    """PNG of 8 bits, probability x 255 rounded."""
    return encode(".png", cv2.convertScaleAbs(boundary, alpha=255), _PNG_STORED)


_ENCODERS: dict[str, Callable[[NDArray[Any]], memoryview]] = {
    "semantic": encode_semantic,
    "depth": encode_depth,
    "boundary": encode_boundary,
}


def encode(suffix: str, image: Any, parameters: tuple[int, ...]) -> memoryview:
    """Encode an image, blue first, in memory."""
    _, content = cv2.imencode(suffix, image, parameters)
    return content.ravel().data


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file under a temporary name, then rename it: it is whole or not there.

    Raises OutputError.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(
                f"cannot write {path} ({error.strerror}): make room or choose another --out; "
                "what was finished before is kept"
            ) from error
        raise


def _prepare(folder: Path, *, overwrite: bool) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    ours = (folder / _MARKER).exists()
    if any(folder.iterdir()):
        if not overwrite:
            raise OutputError(
                f"the output folder {folder} is not empty: choose another --out, or replace an "
                "earlier run with --overwrite"
            )
        if not ours:
            raise OutputError(
                f"the output folder {folder} holds files that ssdnet-run did not make: it "
                "replaces nothing but its own runs, choose another --out"
            )
        _remove_run(folder)
    write_whole(folder / _MARKER, _MARKER_TEXT)


def _remove_run(folder: Path) -> None:
    """Remove what an earlier run wrote; files of other names stay."""
    for kind in KINDS:
        for path in (folder / kind).glob("*" + _SUFFIX[kind]):
            path.unlink()
    for name in (FRAMES_FILE, REPORT_FILE, LATENCY_FILE):
        (folder / name).unlink(missing_ok=True)
