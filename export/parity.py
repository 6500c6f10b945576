"""Measure how far an exported file is from its network in PyTorch, a head at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from export.errors import ExportError
from export.probe_frames import ProbeFrame
from models import Network
from runtime import Predictor
from runtime.session import open_session

#: Largest difference of the depth, as a share of the depth range: 5 mm at 100 m, the step of a
#: 16-bit depth PNG, a quarter of a LiDAR's noise. Rounding in fp32 comes to about a tenth of it.
DEPTH_TOLERANCE = 5e-5
#: Largest difference of a probability; a tenth of the step of an 8-bit picture.
BOUNDARY_TOLERANCE = 4e-4
#: Largest difference of the logits, as a share of the largest logit of the frame.
LOGITS_TOLERANCE = 1e-4
#: Smallest share of pixels with the same class. Rounding flips a pixel only where two classes tie.
SEMANTIC_AGREEMENT = 0.9995


@dataclass(frozen=True)
class HeadParity:
    """The worst of one head over all frames, and whether it is within tolerance."""

    #: For example {"max_abs_m": 0.0002, "mean_abs_m": 0.00001} or {"agreement": 0.99998}.
    figures: Mapping[str, float]
    passed: bool


def measure_parity(
    model: Network, onnx_path: Path | str, frames: Sequence[ProbeFrame], *, dynamic: bool = False
) -> dict[str, HeadParity]:
    """Compare every head of the file, run by `runtime.Predictor`, with the network in PyTorch.

    The frames have the size of the file or, if it is ``dynamic``, any size, and run at it. As the
    predictor cleans a depth map before the graph sees it, each frame also goes to the bare graph,
    which must answer the same. Raises the engine's errors if the file cannot be run, and
    ExportError if an answer has another shape.
    """
    measured: dict[str, list[dict[str, float]]] = {}
    with Predictor(onnx_path, size="frame" if dynamic else None, warmup=0) as predictor:
        session = open_session(
            Path(onnx_path).read_bytes(), provider="cpu", device_id=0, threads=predictor.threads
        )
        for frame in frames:
            expected = reference(model, frame)
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
            feed = {"rgb": frame.rgb[None], "sparse_depth": frame.sparse_depth[None]}
            bare = dict(zip(predictor.heads, session.run(predictor.heads, feed), strict=True))
            for head in predictor.heads:
                for answer in (getattr(prediction, head), bare[head][0]):
                    figures = _compare(head, answer, expected[head])
                    measured.setdefault(head, []).append(figures)
    return {
        head: _worst(head, figures, max_depth_m=model.config.max_depth_m)
        for head, figures in measured.items()
    }


def reference(model: Network, frame: ProbeFrame) -> dict[str, NDArray[Any]]:
    """Answer a frame with the network itself, by its training forward at full size."""
    rgb = torch.from_numpy(frame.rgb).permute(2, 0, 1)[None].float()
    with torch.inference_mode():
        output = model(rgb, torch.from_numpy(frame.sparse_depth)[None, None])
    answers = {}
    if output.boundary_logits is not None:
        answers["boundary"] = torch.sigmoid(output.boundary_logits)[0, 0]
    if output.semantic_logits is not None:
        answers["semantic_logits"] = output.semantic_logits[0]
        answers["semantic"] = output.semantic_logits[0].argmax(dim=0).to(torch.uint8)
    if output.depths is not None:
        answers["depth"] = output.depths[0][0, 0] * model.config.max_depth_m
    return {head: answer.numpy() for head, answer in answers.items()}


def _compare(head: str, answer: NDArray[Any], expected: NDArray[Any]) -> dict[str, float]:
    if answer.shape != expected.shape:
        raise ExportError(f"{head} has the shape {answer.shape}, in PyTorch {expected.shape}")
    if head == "semantic":
        return {"agreement": float((answer == expected).mean())}
    difference = np.abs(answer.astype(np.float64) - expected)  # NaN stays NaN, and fails
    if head == "semantic_logits":
        difference /= np.abs(expected).max()
        return {"max_relative": float(difference.max())}
    unit = "_m" if head == "depth" else ""
    return {f"max_abs{unit}": float(difference.max()), f"mean_abs{unit}": float(difference.mean())}


def _worst(head: str, figures: list[dict[str, float]], *, max_depth_m: float) -> HeadParity:
    pick = np.min if head == "semantic" else np.max  # both let NaN through
    worst = {name: float(pick([figure[name] for figure in figures])) for name in figures[0]}
    if head == "semantic":
        return HeadParity(worst, worst["agreement"] >= SEMANTIC_AGREEMENT)
    limit = {
        "depth": DEPTH_TOLERANCE * max_depth_m,
        "boundary": BOUNDARY_TOLERANCE,
        "semantic_logits": LOGITS_TOLERANCE,
    }[head]
    return HeadParity(worst, next(iter(worst.values())) <= limit)
