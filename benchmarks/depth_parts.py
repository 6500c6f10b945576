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

import rigs
from export.deploy import DeployGraph
from models import Network, load_checkpoint, planes, surfaces
from models.blocks import upsample
from random_weights import export_graph
from runtime.tools.bench import BenchOptions, bench
from training.evaluation.scored_model import open_model

SIZE = (512, 1024)
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


def leave_out_surface(index: int) -> AbstractContextManager[object]:
    """Leave out the nearest (0) or the farthest surface (1)."""
    departures = surfaces.departures

    def others(
        found: surfaces.Surfaces,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        near, far = departures(found)
        return (0 * near, far) if index == 0 else (near, 0 * far)

    return patch.object(surfaces, "departures", others)


def decide_by(beside: float) -> AbstractContextManager[object]:
    """Take position and scale from the image (0) or from the geometry (1) everywhere."""
    join = surfaces.HeadChannels.join
    return patch.object(
        surfaces.HeadChannels,
        "join",
        lambda image, geometry, share: join(image, geometry, torch.full_like(share, beside)),
    )


def leave_out_detail() -> AbstractContextManager[object]:
    """Take the mean of the base in each cell."""
    enlarge = surfaces.to_image_size
    return patch.object(
        surfaces,
        "to_image_size",
        lambda *maps: enlarge(*maps[:4], base=upsample(maps[3].base)),
    )


#: Part -> leaves it out.
PARTS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "nothing": nullcontext,
    "the anchoring": lambda: patch.object(planes, "anchor", lambda plane, _: plane),
    "the detail of the base in a cell": leave_out_detail,
    "the nearest surface": lambda: leave_out_surface(0),
    "the farthest surface": lambda: leave_out_surface(1),
    "the choice from the geometry": lambda: decide_by(0.0),
    "the choice from the image": lambda: decide_by(1.0),
    "the limit of the guess": lambda: patch.object(
        surfaces, "limit_guess", lambda _, density: torch.ones_like(density)
    ),
    "returns at full size": lambda: patch.object(
        surfaces, "take_returns", lambda inverse, scale, *_, **__: (1.0 / inverse, scale)
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
