"""The implementation of `Prediction.draw` and `Prediction.save`."""

import io
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.base.arguments import array_dtype
from runtime.base.errors import InputError, OutputError
from runtime.contract.contract import ClassInfo
from runtime.drawing.encode import encode_jpeg, encode_ply, encode_png
from runtime.drawing.overlay import Overlay
from runtime.engine.prediction import Prediction
from runtime.files.atomic_write import atomic_write
from runtime.geometry.calibration import Calibration

_PICTURES, _ARRAYS, _CLOUD = (".png", ".jpg", ".jpeg"), ".npz", ".ply"


def draw_prediction(
    prediction: Prediction, rgb: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Return the picture of `Prediction.draw`, uint8 (H', W', 3), RGB. Raises InputError."""
    return cv2.cvtColor(_draw(prediction, rgb), cv2.COLOR_BGR2RGB)  # type: ignore[return-value]


def save_prediction(
    prediction: Prediction,
    path: str | PathLike[str],
    rgb: NDArray[np.uint8] | None = None,
    *,
    intrinsics: NDArray[np.floating[Any]] | Calibration | None = None,
) -> None:
    """Write the file of `Prediction.save`. Raises InputError and OutputError."""
    path = Path(path)
    suffix = path.suffix.lower()
    content: bytes | memoryview
    if suffix in _PICTURES:
        drawn = _draw(prediction, rgb)
        try:
            content = encode_png(drawn) if suffix == ".png" else encode_jpeg(drawn, quality=95)
        except ValueError as error:
            raise OutputError(f"{path}: {error}") from error
    elif suffix == _ARRAYS:
        arrays: dict[str, Any] = {**prediction.heads, "valid": np.bool_(prediction.valid)}
        arrays["degraded"] = np.array(prediction.degraded, dtype=np.str_)
        file = io.BytesIO()
        np.savez(file, **arrays)
        content = file.getbuffer()
    elif suffix == _CLOUD:
        if intrinsics is None:
            raise InputError(
                f"{path.name} is a point cloud: give intrinsics=, the camera's calibration or "
                "its 3 x 3 matrix in pixels of the frame"
            )
        classes = prediction.contract.classes if prediction.contract is not None else ()
        content = encode_ply(prediction.points(intrinsics, rgb), classes)
    else:
        known = ", ".join((*_PICTURES, _ARRAYS, _CLOUD))
        raise InputError(f"{path.name} must end in one of {known}")
    atomic_write(path, content)


def _draw(prediction: Prediction, rgb: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """Return the picture in BGR."""
    if (contract := prediction.contract) is None:
        raise InputError(
            "the prediction has no contract, which names the classes and their colours: draw "
            "what Predictor.predict returns, or set contract=predictor.contract"
        )
    expected = (*prediction.frame_size, 3)
    if rgb is not None and (array_dtype(rgb) != np.uint8 or rgb.shape != expected):
        raise InputError(
            f"rgb must be the frame's image, uint8 {expected}, got {array_dtype(rgb)} "
            f"{np.shape(rgb)}"
        )
    return _overlay(contract.classes, contract.max_depth_m).draw(rgb, prediction)


@lru_cache(maxsize=8)
def _overlay(classes: tuple[ClassInfo, ...], max_depth_m: float) -> Overlay:
    """The overlay of a model, cached because it keeps the legend for the next frame."""
    return Overlay(classes, max_depth_m)
