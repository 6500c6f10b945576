"""A reference: frames and the answers to them, for comparison with later answers.

It is a folder that needs nothing else:

| file | content |
|---|---|
| `reference.json` | origin, settings, limits per head, and one line per frame; see `Reference` |
| `model.onnx` | the model that answered, byte for byte |
| `frames/000000.npz` ... | a frame's `rgb`, `sparse_depth` and its answers, one array per head |

The arrays are compressed without loss, with four heads to about 9 of 20 bytes per pixel. NumPy's
archive holds a checksum of every array.
"""

import contextlib
import json
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import runtime
from runtime.base.arguments import check_number, cut, shown
from runtime.base.errors import InputError
from runtime.contract.agreement import compare, reference_limits
from runtime.contract.heads import HEADS
from runtime.contract.model_file import load_model_file
from runtime.contract.network_size import NetworkSize
from runtime.files.own_folder import atomic_folder
from runtime.files.read_input import open_input, read_text

# The name of the format is that of earlier releases, whose references are still read.
REFERENCE_FORMAT, REFERENCE_VERSION = "ssdnet-recording", "2.1"
_READ_VERSIONS = ("2.0", REFERENCE_VERSION)  # version 2.0 does not name the software that wrote it
REFERENCE_FILE, MODEL_FILE = "reference.json", "model.onnx"
_EARLIER_FILE = "recording.json"
_FRAMES = "frames"
_LARGEST = sys.float_info.max  # largest limit or time

MAX_FRAME_BYTES = 2**32  # enough for the largest cameras with all heads


@dataclass(frozen=True)
class ReferenceFrame:
    """Facts about a frame beside its arrays.

    Attributes:
        name: name of the frame, for people.
        valid: whether the answers are usable; if not, none are kept.
        degraded: reasons of `Prediction.degraded`; None if they are unknown because PyTorch
            answered.
        predict_ms: time of `Predictor.predict`; None if it is unknown.
        focal_length_px: focal length that was given to `Predictor.predict`.
    """

    name: str
    valid: bool = True
    degraded: tuple[str, ...] | None = None
    predict_ms: float | None = None
    focal_length_px: float | None = None


@dataclass(frozen=True)
class PredictorSettings:
    """What a `Predictor` needs to repeat the answers.

    Attributes:
        made_by: the command that wrote the reference.
        size: size of the network, as `Predictor` takes it.
        focal_length_px: focal length, as `Predictor` takes it.
        provider: "cpu" or "cuda"; "torch" if PyTorch answered.
    """

    made_by: str
    size: NetworkSize = None
    focal_length_px: float | None = None
    provider: str = "cpu"

    @property
    def from_torch(self) -> bool:
        """Whether PyTorch answered."""
        return self.provider == "torch"


@dataclass(frozen=True)
class Reference:
    """A reference on disk, whose arrays are read one frame at a time.

    Attributes:
        folder: where the reference is.
        settings: settings of the predictor.
        model_name: name of the model that answered.
        model_sha256: SHA-256 of that model's file.
        limits: limits of the figures of each head, see `runtime.contract.agreement`.
        frames: facts about each frame.
        software: versions of "ssdnet", "onnxruntime" and "system" that wrote the reference; empty
            if they are unknown.
    """

    folder: Path
    settings: PredictorSettings
    model_name: str
    model_sha256: str
    limits: Mapping[str, Mapping[str, float]]
    frames: tuple[ReferenceFrame, ...]
    software: Mapping[str, str] = field(default_factory=dict)

    @property
    def model(self) -> Path:
        """Path of the model's file."""
        return self.folder / MODEL_FILE

    def arrays(self, index: int) -> dict[str, NDArray[Any]]:
        """Read "rgb", "sparse_depth" and the answers of one frame. Raises InputError."""
        path = _frame_path(self.folder, index)
        names = ["rgb", "sparse_depth", *(self.limits if self.frames[index].valid else ())]
        try:
            with (
                open_input(path, max_bytes=MAX_FRAME_BYTES) as file,
                np.load(file, allow_pickle=False) as archive,
            ):
                if sorted(archive.files) != sorted(names):
                    raise ValueError(f"it holds {shown(archive.files, 200)}, expected {names}")
                return {name: archive[name] for name in names}
        except InputError:
            raise
        except Exception as error:  # zipfile and numpy raise anything
            reason = f"cannot read {path} ({cut(str(error), 200)})"
            raise InputError(f"{reason}: the reference is damaged, get it again") from error


class ReferenceWriter:
    """Writes a reference into a folder, one frame at a time, see `write_reference`."""

    def __init__(self, folder: Path, settings: PredictorSettings) -> None:
        self._folder, self._settings = folder, settings
        self._frames: list[ReferenceFrame] = []
        self._heads: set[str] = set()
        (folder / _FRAMES).mkdir()

    def add(
        self,
        frame: ReferenceFrame,
        rgb: NDArray[np.uint8],
        sparse_depth: NDArray[np.float32],
        answers: Mapping[str, NDArray[Any]],
    ) -> None:
        """Keep a frame and, if it is valid, its answers by head."""
        self._heads |= answers.keys()
        path = _frame_path(self._folder, len(self._frames))
        # The arrays are kept as `Predictor` got them, NaN included, so that the prediction can be
        # repeated.
        arrays = {"rgb": rgb, "sparse_depth": sparse_depth, **(answers if frame.valid else {})}
        np.savez_compressed(path, **arrays)  # type: ignore[arg-type]  # numpy's stub
        self._frames.append(frame)

    def finish(self, model: Path, *, sha256: str | None = None) -> None:
        """Add the model that answered, and write the document.

        Args:
            model: the model's file.
            sha256: SHA-256 of the file when it was loaded; the file may have been replaced since.

        Raises:
            ContractError: if the file cannot be read or has another SHA-256.
        """
        file = load_model_file(model, sha256=sha256)
        document = {
            "format": REFERENCE_FORMAT,
            "version": REFERENCE_VERSION,
            "settings": asdict(self._settings),
            "software": {
                "ssdnet": runtime.__version__,
                "onnxruntime": _onnxruntime_version(),
                "system": platform.platform(),
            },
            "model": {"name": file.contract.model_name, "sha256": file.sha256},
            "limits": {
                head: reference_limits(head, file.contract, from_torch=self._settings.from_torch)
                for head in HEADS
                if head in self._heads
            },
            "frames": [asdict(frame) for frame in self._frames],
        }
        (self._folder / MODEL_FILE).write_bytes(file.content)
        text = json.dumps(document, indent=1, allow_nan=False)
        (self._folder / REFERENCE_FILE).write_text(text)


@contextlib.contextmanager
def write_reference(
    path: Path, settings: PredictorSettings, *, overwrite: bool = False
) -> Iterator[ReferenceWriter]:
    """Write a reference completely or not at all.

    Args:
        path: the folder, which gets its name when the block ends without an error.
        settings: settings of the predictor.
        overwrite: replace an older reference at `path`; a folder with any other file is never
            replaced.

    Yields:
        The recorder. The block adds frames and then calls `ReferenceWriter.finish`.

    Raises:
        OutputError: if the folder cannot be written or replaced.
    """
    with atomic_folder(path, overwrite=overwrite) as folder:
        yield ReferenceWriter(folder, settings)


def read_reference(folder: Path) -> Reference:
    """Read the document of a reference.

    Raises:
        InputError: if the folder is not a reference, or is damaged.
    """
    path = folder / REFERENCE_FILE
    if not path.exists() and (folder / _EARLIER_FILE).exists():
        path = folder / _EARLIER_FILE
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(
            f"{error}: give a folder made by ssdnet-run --record or "
            "ssdnet-export --record; a run of several cameras has one folder for each"
        ) from error
    try:
        return _parse(folder, json.loads(text))
    except Exception as error:  # a value of an unexpected type may raise anything
        raise InputError(
            f"{path} is not a valid reference ({type(error).__name__}: {error}): it was "
            "changed, or comes from another version; record again"
        ) from error


def _parse(folder: Path, document: Any) -> Reference:
    for key, known in (("format", (REFERENCE_FORMAT,)), ("version", _READ_VERSIONS)):
        if document[key] not in known:
            raise ValueError(f"{key} is {shown(document[key])}, expected {' or '.join(known)}")
    settings, size = document["settings"], document["settings"]["size"]
    size = tuple(size) if isinstance(size, list) else size
    return Reference(
        folder=folder,
        settings=PredictorSettings(**{**settings, "size": size}),
        model_name=str(document["model"]["name"]),
        model_sha256=str(document["model"]["sha256"]),
        limits={head: _limits(head, entry) for head, entry in document["limits"].items()},
        frames=tuple(_frame(entry) for entry in document["frames"]),
        software={key: str(text) for key, text in document.get("software", {}).items()},
    )


def _frame(entry: Any) -> ReferenceFrame:
    degraded = entry["degraded"]
    return ReferenceFrame(**{**entry, "degraded": None if degraded is None else tuple(degraded)})


def _limits(head: str, entry: Mapping[str, Any]) -> dict[str, float]:
    known = compare(head, np.ones(1), np.ones(1)).keys()
    if not entry or entry.keys() - known:
        raise ValueError(f"the limits of {head} are {shown(entry)}, expected some of {[*known]}")
    return {name: check_number(name, each, 0, _LARGEST) for name, each in entry.items()}


def _frame_path(folder: Path, index: int) -> Path:
    return folder / _FRAMES / f"{index:06}.npz"


def _onnxruntime_version() -> str:
    import onnxruntime  # imported here: reading a reference needs no session

    return str(onnxruntime.__version__)
