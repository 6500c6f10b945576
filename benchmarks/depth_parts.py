"""What each part of the depth head of ssdnet-lite brings, and what it costs.

    python benchmarks/depth_parts.py CHECKPOINT --data DIR [--rounds 9] [--threads 2]

Each part is left out of a trained network, which is not trained again. MAE / RMSE in mm, means over
the frames, on DIR/kitti_streets from frame 70 on with 64, 16 and 4 lines, and on a quarter of the
returns of DIR/pandaset_front (`cameras.py`). ms: how much the exported graph is faster without it,
512 x 1024, one thread, median of the differences of rounds in turn.
"""

import argparse
import statistics
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor

from cameras import Frame, read_large, score, thin
from export.deploy import DeployGraph
from models import Network, load_checkpoint, surfaces
from random_weights import export_graph
from runtime.tools.bench import BenchOptions, bench
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.evaluation.scored_model import open_model
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import open_dataset

SIZE = (512, 1024)
LINES = ("64", "16", "4")
#: Calls of `surfaces.replace` by a frame: the plane, the farthest and the nearest surface, returns.
_CALLS = 4


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--data", type=Path, required=True, action="append")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    sets = {f"{lines} lines": list(read_streets(arguments.data, lines)) for lines in LINES}
    large = read_large(arguments.data)
    sets["PandaSet, a quarter"] = [thin(frame, 0.25, index) for index, frame in enumerate(large)]
    saved_ms = time_parts(arguments.checkpoint, arguments.rounds)
    print(f"| without | {' | '.join(sets)} | ms |")
    print("|---" * (len(sets) + 2) + "|")
    for name, leave_out in PARTS.items():
        with (
            leave_out(),
            open_model(arguments.checkpoint, threads=arguments.threads) as model,
        ):
            figures = [score(model.predict, frames, focal=False) for frames in sets.values()]
        cells = [f"{1e3 * mae:.0f} / {1e3 * rmse:.0f}" for mae, rmse, _ in figures]
        print(f"| {name} | {' | '.join(cells)} | {saved_ms[name]:.1f} |", flush=True)


def read_streets(folders: list[Path], lines: str) -> Iterator[Frame]:
    """Read the validation frames with so many lines."""
    recipe = KittiStreetsRecipe(path="kitti_streets", first=70)
    source = open_dataset(recipe, folders, classes="camvid")
    for index in range(len(source)):
        sample = source[index]
        split = split_lidar(sample, LidarInput.parse(lines), frame_generator(index))
        if split is not None:
            yield Frame(sample.rgb, split.fed, split.target, sample.focal_length_px or np.nan)


def skip_replacement(call: int) -> AbstractContextManager[object]:
    """Leave out one call of `surfaces.replace` of every frame."""
    replace, calls = surfaces.replace, [0]

    def replace_others(
        depth: Tensor, spread: Tensor | float, step: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        calls[0] += 1
        if (calls[0] - 1) % _CALLS == call:
            return depth, torch.zeros_like(depth) + spread
        return replace(depth, spread, step, weight)

    return patch.object(surfaces, "replace", replace_others)


#: Part -> leaves it out.
PARTS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "nothing": nullcontext,
    "the limit of the guess": lambda: patch.object(
        surfaces, "limit_guess", lambda _, density: torch.ones_like(density)
    ),
    "the nearest surface": lambda: skip_replacement(2),
    "the farthest surface": lambda: skip_replacement(1),
    "the correction": lambda: patch.object(surfaces, "correct", lambda depth, *_: depth),
    "returns at full size": lambda: skip_replacement(3),
    "the semantic features": lambda: patch.object(
        surfaces.SurfaceDepthHead, "add_semantics", lambda head, features, _: features
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
