"""Networks timed in turns in one process: what the programs beside it share.

Everything is timed as the engine runs it, from uint8 pixels and metres to answers at full size.
"""

import json
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor

from export.deploy import DeployGraph
from export.trace import trace
from models import Network
from models.blocks import upsample
from runtime.engine_facts import cpu_name
from runtime.session import open_session
from training.evaluation.classical import CompletionMethod

Size = tuple[int, int]  # (height, width)
Frame = dict[str, NDArray[Any]]
#: What can be timed: an ONNX file, or a classical method of depth completion.
Model = bytes | CompletionMethod

_WARM_UP = 2
#: Operators that are counted.
_COUNTED = ("Conv", "ConvTranspose", "Gemm", "MatMul")


class LogitsGraph(DeployGraph):
    """Pixels to scores of every class at full size, as papers time semantic networks."""

    @property
    def heads(self) -> tuple[str, ...]:
        """The one output."""
        return ("semantic_logits",)

    def forward(self, rgb: Tensor, sparse_depth: Tensor) -> tuple[Tensor, ...]:
        """Uint8 (N, H, W, 3) and float32 (N, H, W) -> float32 (N, C, H, W)."""
        height, width = rgb.shape[1], rgb.shape[2]
        coarse = self.model.predict_coarse(
            rgb.permute(0, 3, 1, 2).to(torch.float32), sparse_depth.unsqueeze(1)
        )
        logits = upsample(coarse.semantic_logits, factor=self.model.semantic_stride)
        return (logits[:, :, :height, :width],)


@dataclass(frozen=True)
class Cost:
    """What a network is by count, of a frame of one size."""

    #: Of its convolutions and matrices, normalisation folded into them, in 1e6.
    params_m: float
    #: Multiply-accumulates of them, in 1e9.
    gmacs: float


@dataclass(frozen=True)
class Timed:
    """A network with its session and its measured times, a figure a round."""

    name: str
    cost: Cost
    session: Any
    latencies_ms: list[float] = field(default_factory=list)
    #: Processor time of all threads.
    busy_ms: list[float] = field(default_factory=list)


def export_graph(graph: DeployGraph, size: Size, *, dynamic: bool = False) -> bytes:
    """Return the ONNX file of a graph, for one size or, with `dynamic`, for any."""
    return trace(graph, size=size, dynamic=dynamic).SerializeToString()


def deploy(network: Network, size: Size) -> bytes:
    """Return the ONNX file of a network as it would ship, for one size."""
    return export_graph(DeployGraph(network.eval()), size)


def random_frame(size: Size) -> Frame:
    """Return a frame of noise with 5 % of its depth, as the contract has it."""
    rng = np.random.default_rng(0)
    sparse = np.where(rng.random((1, *size)) < 0.05, 80 * rng.random((1, *size)), 0)
    return {
        "rgb": rng.integers(0, 256, (1, *size, 3), dtype=np.uint8),
        "sparse_depth": sparse.astype(np.float32),
    }


class _MethodSession:
    """A classical method with the face of a session."""

    def __init__(self, method: CompletionMethod) -> None:
        self._method = method

    def get_inputs(self) -> list[SimpleNamespace]:
        return [SimpleNamespace(name=name) for name in ("rgb", "sparse_depth")]

    def run(self, _: None, inputs: Frame) -> None:
        self._method.complete(inputs["rgb"][0], inputs["sparse_depth"][0])


def open_timed(name: str, model: Model, size: Size, *, threads: int) -> Timed | None:
    """Open a model's session as the engine does, and count what it costs at `size`.

    None for a file of another, fixed size. A classical method costs time alone.
    """
    if not isinstance(model, bytes):
        return Timed(name, Cost(0.0, 0.0), _MethodSession(model))
    session = open_session(model, provider="cpu", device_id=0, threads=threads)
    sides = session.get_inputs()[0].shape[1:3]
    if any(isinstance(side, int) and side != want for side, want in zip(sides, size, strict=True)):
        return None
    return Timed(name, count_cost(model, size), session)


def count_cost(model: bytes, size: Size) -> Cost:
    """Count a model's weights, and its multiply-accumulates at `size`, by running it once."""
    options = onnxruntime.SessionOptions()
    # As exported: what ONNX Runtime makes of it has other operators.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    options.enable_profiling = True
    options.add_session_config_entry("session.disable_prepacking", "1")  # it hides weights
    with tempfile.TemporaryDirectory() as folder:
        options.profile_file_prefix = str(Path(folder) / "profile")
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        session.run(None, _inputs_of(session, random_frame(size)))
        events = json.loads(Path(session.end_profiling()).read_text())
    macs = 0
    for event in events:
        arguments = event.get("args", {})
        if arguments.get("op_name") not in _COUNTED:
            continue
        if "output_type_shape" not in arguments:
            continue
        (taken, weight, *_), (given,) = (
            [next(iter(tensor.values())) for tensor in arguments[key]]
            for key in ("input_type_shape", "output_type_shape")
        )
        match arguments["op_name"]:
            case "Conv":
                macs += np.prod(given) * np.prod(weight[1:])
            case "ConvTranspose":
                macs += np.prod(taken) * np.prod(weight[1:])
            case _:
                macs += np.prod(given) * taken[-1]
    return Cost(_count_params(model) / 1e6, float(macs) / 1e9)


def _count_params(model: bytes) -> float:
    """Constants of the operators that are counted, each once however often it is used."""
    graph = onnx.load_from_string(model).graph
    used = {name for node in graph.node if node.op_type in _COUNTED for name in node.input}
    return float(sum(np.prod(item.dims) for item in graph.initializer if item.name in used))


def measure(timed: Sequence[Timed], size: Size, *, rounds: int) -> None:
    """Run all networks in turn, so that a disturbance hits each of them alike."""
    frame = random_frame(size)
    for index in range(rounds + _WARM_UP):
        for item in timed:
            inputs = _inputs_of(item.session, frame)
            started, worked = time.perf_counter(), time.process_time()
            item.session.run(None, inputs)
            if index >= _WARM_UP:
                item.latencies_ms.append((time.perf_counter() - started) * 1e3)
                item.busy_ms.append((time.process_time() - worked) * 1e3)


def figures(timed: Sequence[Timed], reference: Timed) -> list[dict[str, Any]]:
    """Return a row a network; "ratio" is the median of its ratios to the reference, a round each.

    "cpu_ratio" is the same of processor time, which other programs lengthen less.
    """
    return [
        {
            "network": item.name,
            "params_m": item.cost.params_m,
            "gmacs": item.cost.gmacs,
            "median_ms": statistics.median(item.latencies_ms),
            "min_ms": min(item.latencies_ms),
            "ratio": _ratio(item.latencies_ms, reference.latencies_ms),
            "cpu_ms": statistics.median(item.busy_ms),
            "cpu_ratio": _ratio(item.busy_ms, reference.busy_ms),
        }
        for item in timed
    ]


def to_markdown(rows: Sequence[dict[str, Any]], reference: str) -> str:
    """Lay rows of `figures` out as a table."""
    titles = (
        "network",
        "params M",
        "GMACs",
        "median ms",
        "min ms",
        f"ratio to {reference}",
        "processor ms",
        "its ratio",
    )
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    lines += [
        f"| {row['network']} | {row['params_m']:.2f} | {row['gmacs']:.2f} | "
        f"{row['median_ms']:.1f} | {row['min_ms']:.1f} | {row['ratio']:.2f} | "
        f"{row['cpu_ms']:.1f} | {row['cpu_ratio']:.2f} |"
        for row in rows
    ]
    return "\n".join(lines)


def machine(*, threads: int, rounds: int) -> dict[str, Any]:
    """Return what a figure of time must name; the load is that of the last minute."""
    return {
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "threads": threads,
        "rounds": rounds,
        "onnxruntime": version("onnxruntime"),
        "python": platform.python_version(),
    }


def describe(where: dict[str, Any]) -> str:
    """`machine` in a line."""
    return (
        f"{where['cpu']}, {where['cores']} cores, {where['threads']} threads, load "
        f"{where['load']:.2f} at the start, onnxruntime {where['onnxruntime']}, "
        f"{where['rounds']} rounds in turn"
    )


def _ratio(times: Sequence[float], reference: Sequence[float]) -> float:
    return statistics.median(a / b for a, b in zip(times, reference, strict=True))


def _inputs_of(session: Any, frame: Frame) -> Frame:
    return {item.name: frame[item.name] for item in session.get_inputs()}
