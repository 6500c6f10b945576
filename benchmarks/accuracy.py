"""Accuracy of an exported model through the engine itself, beside classical baselines.

    python benchmarks/accuracy.py --data DIR [--data DIR ...] [--model NAME|PATH] [--json OUT]

Scores whatever it finds below the --data folders: `camvid` (val; RGB only, no depth given),
`kitti_stream` (frames 50-59; every second scan line fed, the others scored) and `rendered/val`
(64 simulated scan lines fed, all pixels scored). Depth is scored up to 100 m. Everything runs at
the frames' own size.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from tqdm import tqdm

from runtime import Predictor
from runtime.io.atomic_write import atomic_write
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_stream import KittiStreamRecipe
from training.datasets.sample import SampleSource
from training.datasets.virtual_kitti import RenderedRecipe
from training.evaluation.exported_model import engine_predict, open_method
from training.evaluation.scoring import Predict, Scores, score, split_frames
from training.lidar.split import LidarInput, LidarSplit
from training.loading.open_dataset import open_dataset

SETS = {
    "CamVid val": CamVidRecipe(path="camvid", split="val"),
    "KITTI frames 50-59": KittiStreamRecipe(path="kitti_stream", first=50, last=59),
    "rendered val": RenderedRecipe(path="rendered/val"),
}
#: Classical methods that need no more than milliseconds.
BASELINES = ("nearest", "ip-basic")


def main() -> None:
    """Print a table a set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, action="append", required=True)
    parser.add_argument("--model", help="bundled model or ONNX file; ssdnet-lite by default")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    figures = {}
    with Predictor(arguments.model, size="frame") as predictor:
        classes = [info.name for info in predictor.contract.classes]
        for title, recipe in SETS.items():
            if not any((root / recipe.path).is_dir() for root in arguments.data):
                print(f"## {title}: no folder {recipe.path}, left out\n")
                continue
            source = open_dataset(recipe, arguments.data, classes="camvid")
            ways: dict[str, Predict] = {"ssdnet": engine_predict(predictor)}
            if recipe.kind != "camvid":
                ways |= {name: open_method(name).predict for name in BASELINES}
            print(f"## {title}, {len(source)} frames")
            figures[title] = {}
            for name, way in ways.items():
                scores = score(way, frames(source, name), num_classes=len(classes))
                figures[title][name] = report(name, scores, classes)
            print()
    if arguments.json:
        atomic_write(arguments.json, json.dumps(figures, indent=2).encode())


def frames(source: SampleSource, title: str) -> Iterator[LidarSplit]:
    """Yield every frame with the depth to feed and to score."""
    indices = tqdm(range(len(source)), desc=title, disable=None)
    yield from split_frames(source, indices, LidarInput("own"))


def report(name: str, scores: Scores, classes: list[str]) -> dict[str, float]:
    """Print one model's figures and return them."""
    figures = scores.figures(classes)
    print(f"- {name}: " + ", ".join(f"{key} {value:.4g}" for key, value in figures.items()))
    return figures


if __name__ == "__main__":
    main()
