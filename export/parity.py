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
from runtime.contract import Contract
from runtime.heads import HEADS, Difference
from runtime.io.agreement import compare, file_limits, first_figure, within, worst
from runtime.session import open_session

#: Differences of which a single pixel would decide.
_SINGLE_PIXELS = (Difference.ABSOLUTE, Difference.RELATIVE)
#: The figure that is judged in their place in half precision, and its limit.
_BEYOND, _MOST_BEYOND = "share_beyond", 0.03


@dataclass(frozen=True)
class HeadParity:
    """The worst difference of one head over all frames.

    Attributes:
        figures: see `runtime.io.agreement.compare`.
        passed: whether they are within the tolerance.
    """

    figures: Mapping[str, float]
    passed: bool


def measure_parity(
    model: Network, onnx_path: Path | str, frames: Sequence[ProbeFrame], *, dynamic: bool = False
) -> dict[str, HeadParity]:
    """Compare every head of the file, run by `runtime.Predictor`, with the network in PyTorch.

    The predictor cleans a depth map before the graph sees it, so each frame also goes to the bare
    graph, which must give the same answer. In half precision the choice between two surfaces may
    differ in single pixels: there the share of the pixels beyond the limit is judged.

    Args:
        model: the network.
        onnx_path: the exported file.
        frames: of the size of the file or, if it is dynamic, of any size.
        dynamic: whether the file takes any size.

    Returns:
        Head -> its worst difference.

    Raises:
        ExportError: if an answer has another shape.
        SSDNetError: if the file cannot be run.
    """
    measured: dict[str, list[dict[str, float]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that fp16 is slow on the processor
        predictor = Predictor(onnx_path, size="frame" if dynamic else None, warmup=0)
    contract = predictor.contract
    half = contract.precision == "fp16"
    with predictor:
        session = open_session(
            Path(onnx_path).read_bytes(), provider="cpu", device_id=0, threads=predictor.threads
        )
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
                    if half and HEADS[head].difference in _SINGLE_PIXELS:
                        figures[_BEYOND] = _share_beyond(head, answer, expected[head], contract)
                    measured.setdefault(head, []).append(figures)
    parity = {}
    for head, all_figures in measured.items():
        largest = worst(all_figures)
        limits = file_limits(head, contract)
        if _BEYOND in largest:
            limits = {_BEYOND: _MOST_BEYOND}
        parity[head] = HeadParity(largest, within(largest, limits))
    return parity


def _share_beyond(
    head: str, answer: NDArray[Any], expected: NDArray[Any], contract: Contract
) -> float:
    """Return the share of values that differ by more than the limit of the largest difference."""
    limit = file_limits(head, contract)[first_figure(head)]
    if HEADS[head].difference is Difference.RELATIVE:
        limit *= float(np.abs(expected).max())
    return 1 - float((np.abs(answer.astype(np.float64) - expected) <= limit).mean())


def reference(model: Network, frame: ProbeFrame) -> dict[str, NDArray[Any]]:
    """Return the network's own answers to a frame, head -> array, by its training forward."""
    rgb = torch.from_numpy(frame.rgb).permute(2, 0, 1)[None].float()
    with torch.inference_mode():
        output = model(rgb, torch.from_numpy(frame.sparse_depth)[None, None])
        found = answers(output, model.config.max_depth_m)
    return {head: values[0].numpy() for head, values in found.items()}
