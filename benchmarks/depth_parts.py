"""What each part of the depth head of ssdnet-lite brings, and what it costs.

    python benchmarks/depth_parts.py CHECKPOINT --data DIR [--rounds 9] [--threads 2]

Each part is left out of a trained network, which is not trained again. Error: the mean over the
sets of a column (`rigs.py`) of MAE and of RMSE, divided by those of the whole network. ms: how much
the exported graph is faster without it, 512 x 1024, one thread, median of the differences of rounds
in turn.
"""

import argparse
import statistics
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import rigs
from export.deploy import DeployGraph
from models import Network, load_checkpoint, planes, surface_depth, surfaces
from random_weights import export_graph
from runtime.tools.bench import BenchOptions, bench
from training.evaluation.scored_model import open_model

SIZE = (512, 1024)
#: Calls of `surface_depth.replace` by a frame: plane, farthest surface, nearest surface, returns.
_CALLS = 4
#: Column -> sets of `rigs.SETS`.
COLUMNS = {
    "streets": ("streets, 64 lines", "16 lines", "4 lines"),
    "KITTI's returns": ("streets, raw half", "drive 0009, 16 lines", "KITTI 50 to 59, 32 lines"),
    "PandaSet": ("PandaSet, cross", "half", "quarter", "forward"),
    "Delft": ("Delft, half", "Delft, quarter"),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--data", type=Path, required=True, action="append")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    names = [name for column in COLUMNS.values() for name in column]
    frames = {name: list(rigs.SETS[name][1](arguments.data)) for name in names}
    saved_ms = time_parts(arguments.checkpoint, arguments.rounds)
    print(f"| without | {' | '.join(COLUMNS)} | ms |\n{'|---' * (len(COLUMNS) + 2)}|")
    whole: Mapping[str, NDArray[np.float64]] = {}
    for part, leave_out in PARTS.items():
        with (
            leave_out(),
            open_model(arguments.checkpoint, threads=arguments.threads, size="frame") as model,
        ):
            figures = {name: rigs.score(model.predict, frames[name])[:2] for name in names}
        whole = whole or figures
        cells = []
        for column in COLUMNS.values():
            mae, rmse = np.mean([figures[name] / whole[name] for name in column], axis=0)
            cells.append(f"{mae:.3f} / {rmse:.3f}")
        print(f"| {part} | {' | '.join(cells)} | {saved_ms[part]:.1f} |", flush=True)


def skip_replacement(call: int) -> AbstractContextManager[object]:
    """Leave out one call of `surface_depth.replace` of every frame."""
    replace, calls = surface_depth.replace, [0]

    def replace_others(
        depth: Tensor, spread: Tensor | float, step: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        calls[0] += 1
        if (calls[0] - 1) % _CALLS == call:
            return depth, torch.zeros_like(depth) + spread
        return replace(depth, spread, step, weight)

    return patch.object(surface_depth, "replace", replace_others)


#: Part -> leaves it out.
PARTS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "nothing": nullcontext,
    "the base beside returns": lambda: patch.object(
        surface_depth, "join_base", lambda inverse, scale, *_: (inverse, scale)
    ),
    "departures from it": lambda: patch.object(surface_depth, "position", torch.zeros_like),
    "the anchoring": lambda: patch.object(planes, "anchor", lambda plane, _: plane),
    "the limit of the guess": lambda: patch.object(
        surfaces, "limit_guess", lambda _, density: torch.ones_like(density)
    ),
    "the nearest surface": lambda: skip_replacement(2),
    "the farthest surface": lambda: skip_replacement(1),
    "the correction": lambda: patch.object(surface_depth, "correct", lambda depth, *_: depth),
    "returns at full size": lambda: skip_replacement(3),
    "the semantic features": lambda: patch.object(
        surface_depth.SurfaceDepthHead, "add_semantics", lambda head, features, _: features
    ),
}


def time_parts(checkpoint: Path, rounds: int) -> dict[str, float]:
    """Part -> time [ms] by which a frame is faster without it."""
    network: Network = load_checkpoint(checkpoint).model
    with TemporaryDirectory() as folder:
        files = []
        for number, leave_out in enumerate(PARTS.values()):
            path = Path(folder) / f"{number}.onnx"
            with leave_out():
                path.write_bytes(export_graph(DeployGraph(network)))
            files.append(str(path))
        report = bench(BenchOptions(tuple(files), (SIZE,), (1,), rounds=rounds))
    whole, *others = (row.times_ms for row in report.groups[0])
    differences = [
        statistics.median(a - b for a, b in zip(whole, other, strict=True)) for other in others
    ]
    return dict(zip(PARTS, [0.0, *differences], strict=True))


if __name__ == "__main__":
    main()
