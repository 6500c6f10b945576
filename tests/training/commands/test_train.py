"""`ssdnet-train`: what a run shows, names and refuses."""

import csv
import json
import re

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from layouts.virtual_kitti import write_second_edition
from models import load_checkpoint
from training.commands.train import app

RECIPE = """
[model]
name = "ssdnet-lite"
[data]
batch_size = 2
workers = 0
augment = {crop = [32, 32], scale = [1.0, 1.0], lidar_missing = 0.0, lidar_random = 1.0}
source = [{kind = "camvid", path = "camvid"}]
[schedule]
steps = 10
"""
VALIDATION = '\n[[validation.source]]\nkind = "camvid"\npath = "camvid"\n'


@pytest.fixture
def run(tmp_path, data, tiny_lite):
    """Give a function that types the command."""

    def run(*options, recipe=RECIPE, out="run", code=0):
        (tmp_path / "r.toml").write_text(recipe)
        command = [tmp_path / "r.toml", "--data", data, "--out", tmp_path / out, *options]
        result = CliRunner().invoke(app, [str(part) for part in command])
        assert result.exit_code == code, result.output
        return result

    return run


def test_a_resumed_run_names_its_step_and_not_its_first_weights(run, tmp_path, data, monkeypatch):
    threads = []
    monkeypatch.setattr(torch, "set_num_threads", threads.append)
    run("--stop-after", "1", "--threads", "3", out="first")
    assert threads == [3]
    # Its class begins at random, since the initial weights have another name for theirs.
    classes = "model = {name = 'ssdnet-lite', classes = [{name = 'palisade', color = [0, 0, 0]}]}"
    for path in (data / "camvid/trainannot").iterdir():
        cv2.imwrite(str(path), np.zeros((64, 80), np.uint8))
    options = ("--init", str(tmp_path / "first/last.pt"), "--set", classes)
    source = "{kind = 'folders', path = 'camvid', rgb = 'train', labels = 'trainannot'}"
    options += ("--set", f"data.source = [{source}]", "--set", "data.workers = 500")
    first = run(*options, "--stop-after", "2")
    assert "classes that none of its classes is like begin at random: palisade" in first.stderr
    assert "resumed at" not in first.stderr
    second = run(*options, "--stop-after", "3")
    assert "resumed at step 2 of 10" in second.stderr
    assert "at random" not in second.stderr
    document = json.loads((tmp_path / "run/recipe.json").read_text())
    assert document["recipe"]["data"]["workers"] == 500  # no more were started than cores


def test_validation_sets_are_scored_under_their_names(run, tmp_path):
    """One folder is a set twice, once with a name of its own; the default name is the path."""
    both = VALIDATION + 'name = "town"\n' + VALIDATION
    options = ("--set", "schedule.steps = 2", "--set", 'validation.best = "town/miou"')
    run(*options, recipe=RECIPE + both)
    with (tmp_path / "run/scores.csv").open() as file:
        rows = [(int(row["step"]), row["set"]) for row in csv.DictReader(file)]
    assert rows == [(step, name) for step in (1, 2) for name in ("town", "camvid")]


def test_a_dry_run_draws_the_first_batch_and_writes_nothing_else(run, tmp_path, data):
    write_second_edition(data / "scenes", magnify=8)
    result = run("--dry-run", "--set", "data.source = [{kind = 'rendered', path = 'scenes'}]")
    (path,) = (tmp_path / "run").iterdir()
    assert path.name == "batch.png"
    assert str(path) in result.stdout.splitlines()
    assert "crops of 32 x 32 px" in result.stdout
    assert re.search(r"scenes: \d+ frames", result.stdout)
    assert re.search(r"classes \(\d+% of the pixels\): sky \d+\.\d%, building", result.stdout)
    assert re.search(r"depth \([\d.]+% of .*: 1 % [\d.]+ m, 50 % [\d.]+ m, 99 %", result.stdout)
    picture = cv2.imread(str(path))
    assert picture.shape[1] == 4 * 32  # image, classes, depth, LiDAR input
    assert picture.shape[0] > 2 * 32  # two samples and the legend
    # What cannot start is refused as without --dry-run.
    for change, text in (
        ("optimizer.learning_rate = 0.0", "nothing would learn"),
        ("validation.best = 'camvid/mae_m'", "best = 'camvid/mae_m'; camvid gives miou, accuracy"),
        ("data.source = [{kind = 'camvid', path = 'x'}]", "no folder 'x'"),
    ):
        result = run("--dry-run", "--set", change, recipe=RECIPE + VALIDATION, out="other", code=1)
        assert text in result.output.replace("\n", " ")
    assert not (tmp_path / "other").exists()
    assert "r.toml: cannot be written" in run("--dry-run", out="r.toml", code=1).output


# A training with settings of its own, for the fine-tuning of its weights.
EARLIER = (
    RECIPE.replace("crop = [32, 32]", "crop = [96, 96], pair_shift = 16")
    + """
[model.config]
canonical_focal_px = 700.0
[loss]
depth_form = "metric"
weights = {depth = 0.25, semantic_consistency = 0.5}
[optimizer]
learning_rate = 4e-3
frozen = ["encoder.stem"]
"""
)
# Data and steps alone.
SHORT = "[data]" + RECIPE.split("[data]")[1]


def test_what_a_recipe_leaves_out_comes_from_the_training_of_its_first_weights(run, tmp_path):
    run("--set", "schedule.steps = 1", recipe=EARLIER, out="first")
    init = ("--init", str(tmp_path / "first/model.pt"))
    line = f"from the recipe of {tmp_path}/first/model.pt: "
    result = run(*init, "--stop-after=1", recipe=SHORT, out="second")
    for text in (
        line,
        "model.name = 'ssdnet-lite'",
        "model.config.canonical_focal_px = 700.0",
        "loss.depth_form = 'metric'",
        "loss.weights.depth = 0.25",
        "optimizer.learning_rate = 0.001",
        "optimizer.frozen = ",
    ):
        assert text in result.stderr
    assert "consistency" not in result.stderr  # one view
    recipe = load_checkpoint(tmp_path / "second/last.pt").facts.recipe
    assert recipe["loss"]["depth_form"] == "metric"
    assert recipe["loss"]["weights"]["semantic_consistency"] == 0.0
    # The keys of the recipe come first, and another optimiser has a rate of its own.
    own = SHORT + "[loss]\ndepth_weight = 0.5\n[optimizer]\nname = 'sgd'\n"
    run(*init, "--stop-after=1", recipe=own, out="third")
    recipe = load_checkpoint(tmp_path / "third/last.pt").facts.recipe
    assert recipe["loss"]["weights"]["depth"] == 0.5
    assert (recipe["optimizer"]["name"], recipe["optimizer"]["learning_rate"]) == ("sgd", 2e-3)
    other = SHORT + "[model]\nname = 'ssdnet-small'\n"
    assert line not in run(*init, "--dry-run", recipe=other, out="fourth", code=1).stderr


@pytest.mark.parametrize(("arguments", "line"), [
    (
        ["--adapt", "a drive.mcap", "--out", "rig", "--points", "scans"],
        "--adapt is a command of its own: ssdnet-adapt 'a drive.mcap' --out rig --points scans",
    ),
    (
        ["--init", "ssdnet-lite", "--labels", "l", "--images=i", "--out", "r"],
        "--images is a command of its own: "
        "ssdnet-finetune --init ssdnet-lite --labels l i --out r",
    ),
])  # fmt: skip
def test_an_old_spelling_says_the_new_one(arguments, line):
    """For an option that the command took in earlier releases, a line names the new command."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert result.output.splitlines() == [f"error: {line}"]
