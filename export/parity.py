"""Difference between an exported file and its network in PyTorch."""

import warnings
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
from models.answers import answers
from runtime import Predictor
from runtime.contract.agreement import compare, file_limits, within, worst
from runtime.contract.network_size import NetworkSize
from runtime.engine.session import open_session

# The figure that is limited instead of the largest difference in half precision, and its limit.
_BEYOND, _MOST_BEYOND = "share_beyond", 0.03


@dataclass(frozen=True)
class HeadParity:
    """The worst difference of one head over all frames.

    Attributes:
        figures: see `runtime.contract.agreement.compare`.
        passed: whether the figures are within the tolerance.
    """

    figures: Mapping[str, float]
    passed: bool


def measure_parity(
    model: Network, onnx_path: Path | str, frames: Sequence[ProbeFrame], *, dynamic: bool = False
) -> dict[str, HeadParity]:
    """Compare every head of the file, run by `runtime.Predictor`, with the network in PyTorch.

    The predictor cleans a depth map before the graph sees it, so each frame also goes to the bare
    graph, which must give the same answer. In half precision the choice between two surfaces may
    differ in single pixels; there the share of pixels beyond the limit is judged.

    Args:
        model: the network.
        onnx_path: the exported file.
        frames: frames of the size of the file or, if it is dynamic, of any size.
        dynamic: whether the file takes any size.

    Returns:
        The worst difference of each head.

    Raises:
        ExportError: if an answer has another shape.
        SSDNetError: if the file cannot be run.
    """
    measured: dict[str, list[dict[str, float]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # fp16 is slow on the processor
        threads = torch.get_num_threads()
        size: NetworkSize = "frame" if dynamic else None
        predictor = Predictor(onnx_path, size=size, warmup=0, threads=threads)
    contract = predictor.contract
    with predictor:
        session = open_session(Path(onnx_path).read_bytes(), threads=predictor.threads)
        for frame in frames:
            expected = reference(model, frame)
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
            feed = {"rgb": frame.rgb[None], "sparse_depth": frame.sparse_depth[None]}
            bare = dict(zip(predictor.heads, session.run(predictor.heads, feed), strict=True))
            for head in predictor.heads:
                for answer in (prediction.heads[head], bare[head][0]):
                    if answer.shape != (shape := expected[head].shape):
                        raise ExportError(
                            f"{head} has the shape {answer.shape}, in PyTorch {shape}"
                        )
                    figures = compare(head, answer, expected[head])
                    ((name, limit),) = file_limits(head, contract).items()
                    if contract.precision == "fp16" and name.startswith("max_abs"):
                        right = np.abs(answer - expected[head]) <= limit
                        figures[_BEYOND] = 1 - float(right.mean())
                    measured.setdefault(head, []).append(figures)
    parity = {}
    for head, all_figures in measured.items():
        largest = worst(all_figures)
        limits = {_BEYOND: _MOST_BEYOND} if _BEYOND in largest else file_limits(head, contract)
        parity[head] = HeadParity(largest, within(largest, limits))
    return parity


def reference(model: Network, frame: ProbeFrame) -> dict[str, NDArray[Any]]:
    """Return the network's own answers to a frame, by head, from its training forward."""
    rgb = torch.from_numpy(frame.rgb).permute(2, 0, 1)[None].float()
    with torch.inference_mode():
        output = model(rgb, torch.from_numpy(frame.sparse_depth)[None, None])
        found = answers(output, model.config.max_depth_m)
    return {head: values[0].numpy() for head, values in found.items()}


def require_parity(parity: Mapping[str, HeadParity], advice: str) -> None:
    """Raise ExportError, with this advice, if the answers differ by more than rounding."""
    failed = [
        f"{head} {dict(measured.figures)}"
        for head, measured in parity.items()
        if not measured.passed
    ]
    if failed:
        raise ExportError(
            f"the answers of the exported graph differ from PyTorch's in {'; '.join(failed)}, so "
            f"nothing was written{advice}"
        )
