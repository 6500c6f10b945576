"""Fine-tuning on twenty pictures of three made-up teams, compared with the bundled model.

`python benchmarks/fine_tuning.py DATA OUT [SEED ...]` writes each team's folders to OUT, trains as
`ssdnet-finetune` does with its defaults, and prints the scores of docs/training.md on the test
frames. DATA holds `camvid` and `kitti_streets`. The frames on which settings were chosen and those
of the test were fixed before any training; they are of other places than the pictures of the teams.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from models import load_checkpoint
from models.classes import CAMVID_CLASSES
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from training import finetune
from training.base.tables import build
from training.fine_tuning.verdict import judge, score_both
from training.run.recipe import Recipe
from training.scores.scoring import torch_predict
from training.weights.initial_weights import find_weights, read_weights

CAMVID = tuple(info.name for info in CAMVID_CLASSES)


class Frames(NamedTuple):
    """Frames of CamVid and of the streets: the start of their names, and the step between them."""

    camvid: tuple[str, int, int, int] | None = None  # split/sequence, first, last, step
    streets: tuple[int, int, int] | None = None

    def files(self, data: Path) -> list[tuple[Path, Path]]:
        """Return images and label files."""
        found: list[tuple[Path, Path]] = []
        if self.camvid:
            where, first, last, step = self.camvid
            split, sequence = where.split("/")
            images = sorted((data / "camvid" / split).glob(f"{sequence}_*"))
            labels = data / "camvid" / f"{split}annot"
            found += [
                (image, labels / f"{image.stem}.png") for image in images[first : last + 1 : step]
            ]
        if self.streets:
            first, last, step = self.streets
            streets = data / "kitti_streets"
            labels = sorted((streets / "semantic").glob("*.png"))
            chosen = [path for path in labels if first <= int(path.stem) <= last][::step]
            found += [(streets / "image_02" / f"{path.stem}.jpg", path) for path in chosen]
        return found


class Team(NamedTuple):
    """Pictures, classes as in classes.txt with CamVid's that they are, and frames to score on."""

    pictures: Frames
    classes: dict[str, str]
    chosen_on: Frames
    test: Frames


# CamVid's validation is one drive, of which the start is for choosing and the end for the test; the
# streets from 70 on are no training frames of the bundled model.
_CAMVID_CHOICE, _CAMVID_TEST = ("val/0016E5", 0, 39, 4), ("val/0016E5", 51, 100, 2)
_STREETS_CHOICE, _STREETS_TEST = (70, 81, 1), (83, 98, 1)
TEAMS = {
    "CamVid, five classes": Team(
        Frames(camvid=("train/0006R0", 0, 99, 5)),
        {
            "drivable = road, pavement": "road pavement",
            "structure = building, pole, sign, fence": "building pole sign fence",
            "vegetation": "tree",
            "sky": "sky",
            "traffic = car, pedestrian, bicyclist": "car pedestrian bicyclist",
        },
        Frames(camvid=_CAMVID_CHOICE),
        Frames(camvid=_CAMVID_TEST),
    ),
    "streets, eight classes, one new": Team(
        Frames(streets=(11, 68, 3)),
        {
            "road": "road",
            "sidewalk": "pavement",
            "building": "building",
            "vegetation": "tree",
            "sky": "sky",
            "vehicle": "car",
            "post = pole, sign": "pole sign",
            "palisade": "fence",
        },
        Frames(streets=_STREETS_CHOICE),
        Frames(streets=_STREETS_TEST),
    ),
    "both, five other classes, one new": Team(
        Frames(camvid=("train/0001TP", 0, 59, 6), streets=(12, 66, 6)),
        {
            "flat": "road pavement",
            "background = building, fence, sky": "building fence sky",
            "nature": "tree",
            "mobile = car, pedestrian, bicyclist": "car pedestrian bicyclist",
            "upright things": "pole sign",
        },
        Frames(_CAMVID_CHOICE, _STREETS_CHOICE),
        Frames(_CAMVID_TEST, _STREETS_TEST),
    ),
}


def write_folder(folder: Path, files: Sequence[tuple[Path, Path]], team: Team) -> None:
    """Write images, labels in the team's ids (255 = none), and classes.txt."""
    ids = np.full(256, 255, np.uint8)
    for index, joined in enumerate(team.classes.values()):
        ids[[CAMVID.index(name) for name in joined.split()]] = index
    for kind in ("images", "labels"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for image, label in files:
        (folder / "images" / image.name).write_bytes(image.read_bytes())
        labels = ids[cv2.imread(str(label), cv2.IMREAD_UNCHANGED)]
        cv2.imwrite(str(folder / "labels" / f"{image.stem}.png"), labels)
    (folder / "classes.txt").write_text("\n".join(team.classes) + "\n")


def run_team(team: Team, data: Path, out: Path, seed: int) -> None:
    """Train a team's model, and print its scores on the test frames."""
    for kind, frames in (("pictures", team.pictures), ("test", team.test)):
        write_folder(out / kind, frames.files(data), team)
    own, run = out / "pictures", out / f"run-{seed}"
    found = finetune(
        own / "images",
        labels=own / "labels",
        classes=own / "classes.txt",
        out=run,
        changes=[f"data.seed = {seed}", "data.workers = 0"],
    )
    checkpoint, init = load_checkpoint(found.path), read_weights(find_weights("ssdnet-lite"))
    recipe = build(Recipe, checkpoint.facts.recipe)
    (item,) = recipe.validation.source
    item = replace(item, parts=())
    test = replace(recipe, validation=replace(recipe.validation, source=(item,)))
    test_folder = out / "test"
    pairs = score_both(test, init, checkpoint.model, [test_folder])
    frame = next(iter(bundled_frames()))
    before, after = (
        torch_predict(network)(frame.rgb, frame.sparse_depth, BUNDLED_FOCAL_LENGTH_PX).depth
        for network in (init.network, checkpoint.model)
    )
    print(f"{out.name}, seed {seed}:", *found.lines, "test:", *judge(pairs, init)[1], sep="\n  ")
    print(f"  the depth is equal: {np.array_equal(before, after)}", flush=True)


if __name__ == "__main__":
    for seed in map(int, sys.argv[3:] or ["0"]):
        for name, team in TEAMS.items():
            run_team(team, Path(sys.argv[1]), Path(sys.argv[2]) / name.replace(" ", "_"), seed)
