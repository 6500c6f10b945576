"""Networks side by side on this machine, from raw pixels to answers at full size.

    python benchmarks/speed.py ssdnet-lite ddrnet-23-slim fast-scnn [--reference ddrnet-23-slim] \
        [--sizes 125x414 375x1242 512x1024] [--threads 2] [--rounds 30] \
        [--markdown OUT] [--json OUT]

A network is, in this order:

- an ONNX file or a bundled model by its name, as `Predictor` takes it (a file of fixed size is left
  out at other sizes);
- a checkpoint (*.pt), exported here;
- a classical method of depth completion (ip-basic), which takes one thread, whatever is asked for;
- a name of `models.list_models()` with random weights, which run as fast as trained ones;
  "random:NAME" where a bundled model is called so, too.

Ours answer with class ids, metres and probabilities; semantic networks of others end in float
scores of 19 classes at full size, those for depth in metres. All run in turn in one process,
so that a machine whose speed drifts slows all of them alike: quote the ratios, of a run on a quiet
machine. Sessions are the engine's; what the engine does around them is in latency.py.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from export.deploy import DeployGraph
from models import SSDNet, create_model, list_models, load_checkpoint
from models.registry import NETWORKS
from runtime.bundled_models import find_model, list_bundled_models
from runtime.errors import ContractError, InputError, SSDNetError
from runtime.io.atomic_write import atomic_write
from runtime.model_file import load_model_file
from timing import (
    LogitsGraph,
    Model,
    Size,
    describe,
    export_graph,
    figures,
    machine,
    measure,
    open_timed,
    to_markdown,
)
from training.evaluation.classical import METHODS, create_method

SIZES = [(125, 414), (375, 1242), (512, 1024)]
#: Classes of Cityscapes, for which the others' networks were published.
NUM_CLASSES = 19
#: The graph takes any size; it is traced at this one.
TRACED_AT = (128, 416)
_RANDOM = "random:"


def main() -> None:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("networks", nargs="+", help="ONNX files, checkpoints or names")
    parser.add_argument("--reference", help="what ratios are to; the first network by default")
    parser.add_argument("--sizes", nargs="+", default=SIZES, type=parse_size, help="HEIGHTxWIDTH")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--markdown", type=Path, help="write the tables here, too")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
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
    text = report(document)
    print(text)
    if arguments.markdown:
        atomic_write(arguments.markdown, text.encode())
    if arguments.json:
        atomic_write(arguments.json, json.dumps(document, indent=2).encode())


def parse_size(text: str) -> Size:
    """Read HEIGHTxWIDTH. Raises ValueError."""
    height, width = (int(part) for part in text.split("x"))
    return height, width


def load_network(name: str) -> Model:
    """Return the ONNX file of a network, or a method, see the top. Raises SSDNetError."""
    if name in METHODS:
        return create_method(name)
    if name.endswith(".pt"):
        return export_graph(
            DeployGraph(load_checkpoint(name).model.eval()), TRACED_AT, dynamic=True
        )
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
    return export_graph(graph, TRACED_AT, dynamic=True)


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
        timed = {}
        for name, model in models.items():
            if item := open_timed(name, model, size, threads=threads):
                timed[name] = item
        if reference not in timed:
            raise InputError(f"{reference} is of fixed size: it does not take {size[0]}x{size[1]}.")
        measure(list(timed.values()), size, rounds=rounds)
        rows = figures(list(timed.values()), timed[reference])
        document["sizes"].append({"size": size, "rows": rows})
    return document


def report(document: dict[str, Any]) -> str:
    """A table a size."""
    parts = [describe(document["machine"])]
    for part in document["sizes"]:
        height, width = part["size"]
        table = to_markdown(part["rows"], document["reference"])
        parts.append(f"**{height} x {width}**\n\n{table}")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    main()
