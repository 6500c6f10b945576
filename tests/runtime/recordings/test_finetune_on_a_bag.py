"""`ssdnet-finetune` on a bag of which some frames have labels; the bags are those of this room."""

import tomllib

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from small_rig import SIZE, START_NS

pytest.importorskip("torch", reason="PyTorch (extra train) is not installed")
from models import SSDNetLite, SSDNetLiteConfig, save_checkpoint
from training.commands.finetune import app


@pytest.mark.parametrize("prefix", ["", "bag:"])
def test_labelled_frames_of_a_bag_are_trained_on(record, tmp_path, prefix):
    bag = record("mcap", images=12, scans=12).write()
    small = SSDNetLiteConfig(encoder_widths=(8,) * 16, decoder_channels=(8, 8, 8))
    save_checkpoint(tmp_path / "first.pt", SSDNetLite(small), training={"trained_height": SIZE[0]})
    (tmp_path / "labels").mkdir()
    for index in range(1, 12):
        name = f"{START_NS + index * 10**8}.png"
        cv2.imwrite(str(tmp_path / "labels" / name), np.full(SIZE, index % 2, np.uint8))
    (tmp_path / "classes.txt").write_text("road\nsky\n")
    given = {"labels": "labels", "classes": "classes.txt", "init": "first.pt", "out": "run"}
    options = [text for key, name in given.items() for text in (f"--{key}", str(tmp_path / name))]
    changes = ("--set", "data.workers = 0", "--set", "data.augment.crop = [32, 32]")
    result = CliRunner().invoke(app, [f"{prefix}{bag}", *options, *changes, "--dry-run"])
    assert result.exit_code == 0, result.output
    recipe = tomllib.loads((tmp_path / "run/recipe.toml").read_text())
    (source,) = recipe["data"]["source"]
    assert source["frames"] == [*range(1, 12)]
    assert source.get("source") == (prefix.rstrip(":") or None)
    assert recipe["validation"]["lidar"] == "own"
    assert "train: 4 frames" in result.stdout
