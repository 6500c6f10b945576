"""Networks side by side on this machine, from raw pixels to answers at full size.

    python benchmarks/speed.py ssdnet-lite ddrnet-23-slim fast-scnn [--reference ddrnet-23-slim] \
        [--sizes 125x414 375x1242 512x1024] [--threads 2] [--rounds 30]

A network is, in this order:

- a classical method of depth completion (ip-basic), which runs on one thread;
- a checkpoint (*.pt), exported here;
- an ONNX file or a bundled model by its name, as `Predictor` takes it (a file of fixed size is left
  out at other sizes);
- a name of `models.list_models()` with random weights, which run as fast as trained ones;
  "random:NAME" for the networks that bundled models are named after.

Ours answer with class ids, metres and probabilities; semantic networks of others end in float
scores of 19 classes at full size, those for depth in metres. All run interleaved in one process, so
that a disturbance affects all of them alike: quote the ratios, of a run on a quiet machine.
Sessions are the engine's; what the engine adds to them is in latency.py.
"""

import argparse
import json
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor

from export.deploy import DeployGraph
from export.trace import trace
from models import SSDNet, create_model, list_models, load_checkpoint
from models.blocks import upsample
from models.registry import NETWORKS
from runtime.bundled_models import find_model, list_bundled_models
from runtime.engine_facts import cpu_name
from runtime.errors import ContractError, InputError, SSDNetError
from runtime.model_file import load_model_file
from runtime.session import open_session
from training.evaluation.classical import METHODS, CompletionMethod, create_method

Size = tuple[int, int]  # (height, width)
Frame = dict[str, NDArray[Any]]
#: What can be timed: an ONNX file, or a classical method of depth completion.
Model = bytes | CompletionMethod

SIZES: list[Size] = [(125, 414), (375, 1242), (512, 1024)]
#: Classes of Cityscapes, for which the others' networks were published.
NUM_CLASSES = 19
#: Exported graphs take any size; they are traced at this one.
TRACED_AT = (128, 416)
_RANDOM = "random:"
_WARM_UP = 2
#: Operators whose weights and multiply-accumulates are counted.
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
class Timed:
    """A network that is ready to run, and its measured times, a figure a round.

    Attributes:
        params_m: weights of its convolutions and matrices, normalisation folded in, in millions.
        gmacs: their multiply-accumulates for one frame, in billions.
        run: answers the frame once.
        busy_ms: processor time of all threads.
    """

    name: str
    params_m: float
    gmacs: float
    run: Callable[[], object]
    latencies_ms: list[float] = field(default_factory=list)
    busy_ms: list[float] = field(default_factory=list)


def main() -> None:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("networks", nargs="+", help="ONNX files, checkpoints or names")
    parser.add_argument("--reference", help="what ratios are to; the first network by default")
    parser.add_argument("--sizes", nargs="+", default=SIZES, type=parse_size, help="HEIGHTxWIDTH")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=30)
    arguments = parser.parse_args()
    names = list(dict.fromkeys(arguments.networks))
    reference = arguments.reference or names[0]
    if reference not in names:
        parser.error(f"--reference {reference}: is none of the networks: {', '.join(names)}")
    try:
        models = {name: load_network(name) for name in names}
        document = compare(models, reference, arguments.sizes, arguments.threads, arguments.rounds)
    except SSDNetError as error:
        raise SystemExit(f"error: {error}") from error
    print(report(document))


def parse_size(text: str) -> Size:
    """Read HEIGHTxWIDTH. Raises ValueError."""
    height, width = (int(part) for part in text.split("x"))
    return height, width


def load_network(name: str) -> Model:
    """Return the ONNX file of a network, or a method, see the top. Raises SSDNetError."""
    if name in METHODS:
        return create_method(name)
    if name.endswith(".pt"):
        return export_graph(DeployGraph(load_checkpoint(name).model.eval()))
    known = name.removeprefix(_RANDOM)
    if known in NETWORKS and name not in list_bundled_models():
        return export_random(known)
    try:
        return load_model_file(find_model(name)).content
    except ContractError as error:
        raise InputError(f"{error}. With random weights: {', '.join(list_models())}") from error


def export_random(name: str) -> bytes:
    """Return the ONNX file of a network with random weights."""
    torch.manual_seed(0)
    entry = NETWORKS[name]
    if issubclass(entry.network, SSDNet) or not entry.config.classes:
        graph = DeployGraph(create_model(name).eval())
    else:
        graph = LogitsGraph(create_model(name, num_classes=NUM_CLASSES).eval())
    return export_graph(graph)


def export_graph(graph: DeployGraph) -> bytes:
    """Return the ONNX file of a graph for any size."""
    return trace(graph, size=TRACED_AT, dynamic=True).SerializeToString()


def compare(
    models: dict[str, Model], reference: str, sizes: list[Size], threads: int, rounds: int
) -> dict[str, Any]:
    """Time all models at every size. Raises InputError for a size the reference does not take."""
    document: dict[str, Any] = {
        "machine": machine(threads=threads, rounds=rounds),
        "reference": reference,
        "sizes": [],
    }
    for size in sizes:
        frame = random_frame(size)
        opened = [open_timed(name, model, frame, threads) for name, model in models.items()]
        timed = [item for item in opened if item is not None]
        first = next((item for item in timed if item.name == reference), None)
        if first is None:
            raise InputError(f"{reference} is of fixed size: it does not take {size[0]}x{size[1]}.")
        measure(timed, rounds)
        document["sizes"].append({"size": size, "rows": figures(timed, first)})
    return document


def report(document: dict[str, Any]) -> str:
    """A table a size."""
    parts = [describe(document["machine"])]
    for part in document["sizes"]:
        height, width = part["size"]
        table = to_markdown(part["rows"], document["reference"])
        parts.append(f"**{height} x {width}**\n\n{table}")
    return "\n\n".join(parts) + "\n"


def random_frame(size: Size) -> Frame:
    """Return a frame of noise with 5 % of its depth, as the contract has it."""
    rng = np.random.default_rng(0)
    sparse = np.where(rng.random((1, *size)) < 0.05, 80 * rng.random((1, *size)), 0)
    return {
        "rgb": rng.integers(0, 256, (1, *size, 3), dtype=np.uint8),
        "sparse_depth": sparse.astype(np.float32),
    }


def open_timed(name: str, model: Model, frame: Frame, threads: int) -> Timed | None:
    """Open a model's session as the engine does, and count what a frame costs it.

    None for a file of another, fixed size. A classical method has no such count.
    """
    if not isinstance(model, bytes):
        rgb, sparse_depth = frame["rgb"][0], frame["sparse_depth"][0]
        return Timed(name, 0.0, 0.0, lambda: model.complete(rgb, sparse_depth))
    session = open_session(model, provider="cpu", device_id=0, threads=threads)
    inputs = {item.name: frame[item.name] for item in session.get_inputs()}
    for item in session.get_inputs():
        sides = zip(item.shape, inputs[item.name].shape, strict=True)
        if any(isinstance(side, int) and side != given for side, given in sides):
            return None
    return Timed(name, *count_cost(model, inputs), lambda: session.run(None, inputs))


def count_cost(model: bytes, inputs: Frame) -> tuple[float, float]:
    """Return `Timed.params_m` and `Timed.gmacs` of a model, counted by running it once."""
    options = onnxruntime.SessionOptions()
    # As exported: what ONNX Runtime makes of it has other operators.
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    options.enable_profiling = True
    options.add_session_config_entry("session.disable_prepacking", "1")  # it hides weights
    with tempfile.TemporaryDirectory() as folder:
        options.profile_file_prefix = str(Path(folder) / "profile")
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        session.run(None, inputs)
        events = json.loads(Path(session.end_profiling()).read_text())
    macs = 0
    for event in events:
        arguments = event.get("args", {})
        if arguments.get("op_name") not in _COUNTED or "output_type_shape" not in arguments:
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
    return _count_params(model) / 1e6, float(macs) / 1e9


def _count_params(model: bytes) -> float:
    """Constants of the operators that are counted, each once however often it is used."""
    graph = onnx.load_from_string(model).graph
    used = {name for node in graph.node if node.op_type in _COUNTED for name in node.input}
    return float(sum(np.prod(item.dims) for item in graph.initializer if item.name in used))


def measure(timed: Sequence[Timed], rounds: int) -> None:
    """Run all networks interleaved, after two rounds to warm up."""
    for index in range(rounds + _WARM_UP):
        for item in timed:
            started, worked = time.perf_counter(), time.process_time()
            item.run()
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
            "params_m": item.params_m,
            "gmacs": item.gmacs,
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


if __name__ == "__main__":
    main()
