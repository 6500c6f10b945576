"""Fits offsets of a trained network's logits, one for each class, on its training frames.

    python benchmarks/logit_offsets.py CHECKPOINT --data DIR [--every 6] [--threads 1]

Class by class, in steps of 0.5 and then of 0.25, it maximises the sum of the mIoU on CamVid's
training frames and half of the road's IoU on KITTI's training streets (64 lines), over every n-th
frame of both. The validation frames are only scored before and after. A recipe passes the last line
to `training.weights.release.add_offsets`.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from models import Network, load_checkpoint
from runtime.contract.canonical_focal import camera_scale
from training.datasets.camvid import CamVidRecipe
from training.datasets.kitti_streets import KittiStreetsRecipe
from training.datasets.source_recipe import SourceRecipe
from training.lidar.split import LidarInput, frame_generator, split_lidar
from training.loading.open_dataset import open_dataset
from training.scores.metrics import RoadScores, SemanticScores

# The streets on which the recipes train, and the others.
TRAIN_STREETS, VAL_STREETS = (2, 69), (70, 98)
ROAD_SHARE = 0.5
FARTHEST, STEPS = 1.5, (0.5, 0.25)
LEAST_GAIN = 2e-4

# Logits (C, H, W), labels (H, W).
Frames = list[tuple[NDArray[np.float16], NDArray[np.uint8]]]


def main() -> None:
    """Parse the command line, climb, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    network = load_checkpoint(arguments.checkpoint).model
    names = [info.name for info in network.config.classes]
    sets = {}
    for name, split, (first, last) in (
        ("training frames", "train", TRAIN_STREETS),
        ("validation frames", "val", VAL_STREETS),
    ):
        recipes = (
            CamVidRecipe(path="camvid", split=split),
            KittiStreetsRecipe(path="kitti_streets", first=first, last=last),
        )
        every = arguments.every if split == "train" else 1
        sets[name] = [list(predict(network, item, arguments.data, every)) for item in recipes]

    def score(offsets: NDArray[np.float32]) -> float:
        camvid, streets = sets["training frames"]
        miou, road = rate(camvid, streets, offsets, names)
        return miou + ROAD_SHARE * road

    fitted = climb(score, np.zeros(len(names), np.float32))
    for name, (camvid, streets) in sets.items():
        for title, offsets in (("before", np.zeros_like(fitted)), ("after", fitted)):
            miou, road = rate(camvid, streets, offsets, names)
            print(f"{name}, {title}: CamVid mIoU {miou:.4f}, streets' road IoU {road:.4f}")
    print({name: float(step) for name, step in zip(names, fitted, strict=True) if step})


def predict(
    network: Network, recipe: SourceRecipe, data: Path, every: int
) -> Iterator[tuple[NDArray[np.float16], NDArray[np.uint8]]]:
    """Yield logits and labels of every n-th frame; the labels of streets are the road masks."""
    source = open_dataset(recipe, [data], classes="camvid")
    for index in range(0, len(source), every):
        sample = source[index]
        split = split_lidar(sample, LidarInput.parse("64"), frame_generator(index))
        fed = np.zeros(sample.size, np.float32) if split is None else split.fed
        config, size = network.config, sample.size
        scale = camera_scale(
            config.max_depth_m,
            config.canonical_focal_px,
            sample.focal_length_px,
            frame_size=size,
            network_size=size,
        )
        with torch.inference_mode():
            rgb = torch.from_numpy(sample.rgb).permute(2, 0, 1)[None].float()
            logits = network(rgb, torch.from_numpy(fed)[None, None] * scale.factor).semantic_logits
        assert logits is not None
        labels = sample.targets.get("road_mask", sample.semantic)
        yield logits[0].half().numpy(), labels


def rate(
    camvid: Frames, streets: Frames, offsets: NDArray[np.float32], names: Sequence[str]
) -> tuple[float, float]:
    """Return the mIoU and the road's IoU with the offsets added, each from 0 to 1."""
    semantic, roads = SemanticScores(len(offsets)), RoadScores(len(offsets))
    for frames, scores in ((camvid, semantic), (streets, roads)):
        for logits, labels in frames:
            scores.update((logits + offsets[:, None, None]).argmax(0).astype(np.uint8), labels)
    return semantic.figures()["miou"], roads.figures(names)["road_iou"]


def climb(
    score: Callable[[NDArray[np.float32]], float], offsets: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Change one offset after another while the score rises."""
    best = score(offsets)
    for step in STEPS:
        for index in range(len(offsets)):
            for change in (-step, step):
                while abs(offsets[index] + change) <= FARTHEST:
                    moved = offsets.copy()
                    moved[index] += change
                    reached = score(moved)
                    if reached <= best + LEAST_GAIN:
                        break
                    offsets, best = moved, reached
    return offsets


if __name__ == "__main__":
    main()
