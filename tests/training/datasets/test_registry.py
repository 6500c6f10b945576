"""A file and a line add a kind of data set, and every kind goes to a worker process."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

from layouts import (
    camvid,
    cityscapes,
    kitti_depth,
    kitti_stream,
    kitti_streets,
    virtual_kitti,
)
from layouts.pictures import write
from training.datasets.registry import DATASETS
from training.loading.open_dataset import open_dataset
from training.recipe import AnySource, build

#: A reader and its options in one file, as docs/training.md shows it.
ONE_FILE = '''
"""Grey pictures with a line of text each that says how far away they are."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from training.datasets.sample import Sample
from training.datasets.source_recipe import SourceRecipe
from training.limits import STRICT, Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DistancesRecipe(SourceRecipe):
    """What a recipe says about it."""

    kind: Literal["distances"] = "distances"
    unit_m: Positive = 1.0

    def open(self, folder, classes):
        return Distances(folder, self.unit_m)


class Distances:
    def __init__(self, folder: Path, unit_m: float) -> None:
        self._files, self._unit_m = sorted(folder.glob("*.txt")), unit_m

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> Sample:
        depth = np.full((40, 64), float(self._files[index].read_text()) * self._unit_m, np.float32)
        return Sample(
            rgb=np.full((40, 64, 3), 128, np.uint8),
            targets={"depth": depth},
            intrinsics=None,
            name=self._files[index].stem,
        )
'''

TRAIN = """
import sys
sys.path.append(sys.argv[1])
from distances import DistancesRecipe
from training.datasets.registry import DATASETS
DATASETS["distances"] = DistancesRecipe  # as a line there does
from training.cli import app
from training.recipe import parse_source
assert parse_source("distances:x,unit_m=2").unit_m == 2
from typer.testing import CliRunner
for recipe in sys.argv[3:]:
    result = CliRunner().invoke(app, [recipe, "--data", sys.argv[2], "--out", recipe + ".run"])
    print(result.exit_code, result.output)
"""

RECIPE = """
[model]
name = "ssdnet-small-dep"
[model.config]
encoder_channels = [8, 8]
encoder_blocks = [1, 1]
decoder_channels = [8, 8]
[data]
batch_size = 2
workers = 1
augment.crop = [32, 32]
[[data.source]]
kind = "distances"
path = "far"
unit_m = 0.5
[loss]
class_weighting = "none"
[schedule]
steps = 1
"""


@pytest.mark.slow
def test_a_file_and_a_line_add_a_data_set(tmp_path):
    (tmp_path / "datasets").mkdir()
    (tmp_path / "datasets" / "distances.py").write_text(ONE_FILE)
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "a.txt").write_text("20")
    (tmp_path / "r.toml").write_text(RECIPE)
    (tmp_path / "wrong.toml").write_text(RECIPE.replace("unit_m", "unit_cm"))
    paths = (tmp_path / "datasets", tmp_path, tmp_path / "r.toml", tmp_path / "wrong.toml")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", TRAIN, *map(str, paths)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert (tmp_path / "r.toml.run" / "model.pt").is_file(), done.stdout
    assert not (tmp_path / "wrong.toml.run").exists()
    assert "unknown key data.source[0].unit_cm; known here: kind, path" in done.stdout


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A small folder of every kind, named after it."""
    root = tmp_path_factory.mktemp("data")
    rgb, label = np.zeros((12, 16, 3), np.uint8), np.zeros((12, 16), np.uint8)
    camvid.write_frame(root / "camvid", rgb, label)
    cityscapes.write_frame(root / "cityscapes")
    cityscapes.write_stereo(root / "cityscapes")
    kitti_depth.write_drive(root / "kitti-depth")
    kitti_stream.write_stream(root / "kitti-stream")
    kitti_streets.write_streets(root / "kitti-streets")
    drive = root / "kitti-raw" / "2011_09_26" / "2011_09_26_drive_0001_sync"
    write(drive / "image_02" / "data" / "0000000000.png", np.zeros((8, 16, 3), np.uint8))
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    points = np.array(kitti_stream.POINTS, "<f4")
    (drive / "velodyne_points" / "data" / "0000000000.bin").write_bytes(points.tobytes())
    kitti_stream.write_calibration(drive.parent)
    for kind in ("rendered", "virtual-kitti"):
        virtual_kitti.write_second_edition(root / kind, "Scene02")
    virtual_kitti.write_first_edition(root / "virtual-kitti-1", "0002")
    write(root / "folders" / "images" / "a.png", rgb)
    return root


@pytest.mark.parametrize("kind", DATASETS)
def test_every_kind_goes_to_a_worker_process_even_after_it_was_read(kind, data):
    options = {"kind": kind, "path": kind, "size": [32, 64]}
    classes = "cityscapes" if kind == "cityscapes" else "camvid"
    source = open_dataset(build(AnySource, options), [data], classes=classes)
    expected = source[0]  # what reading leaves behind must not stand in the way
    sample = pickle.loads(pickle.dumps(source))[0]
    assert sample.name == expected.name
    np.testing.assert_array_equal(sample.rgb, expected.rgb)
    np.testing.assert_array_equal(sample.depth, expected.depth)
    assert len(pickle.dumps(source)) < 20_000  # no decoded frames
