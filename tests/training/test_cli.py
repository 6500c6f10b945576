"""`ssdnet-train`: what a run shows, names and refuses."""

import csv
import json
import re

import cv2
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from layouts import camvid
from layouts.virtual_kitti import write_second_edition
from models import SSDNetLite, SSDNetLiteConfig, load_checkpoint
from models.registry import NETWORKS, Entry
from training.cli import app

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


@pytest.fixture(autouse=True)
def tiny_network(monkeypatch):
    config = SSDNetLiteConfig(
        encoder_widths=(8,) * 16,
        decoder_channels=(8, 8, 8),
    )
    monkeypatch.setitem(NETWORKS, "ssdnet-lite", Entry(SSDNetLite, config))


@pytest.fixture
def run(tmp_path):
    """Give a function that types the command with two frames whose upper half is sky."""
    rng = np.random.default_rng(0)
    label = np.full((40, 48), 3, np.uint8)
    label[:20] = 0
    for index in range(2):
        rgb = rng.integers(0, 255, (40, 48, 3), dtype=np.uint8)
        camvid.write_frame(tmp_path / "camvid", rgb, label, str(index))

    def run(*options, recipe=RECIPE, out="run"):
        (tmp_path / "r.toml").write_text(recipe)
        command = [tmp_path / "r.toml", "--data", tmp_path, "--out", tmp_path / out, *options]
        return CliRunner().invoke(app, [str(part) for part in command])

    return run


def read_scores(folder):
    with (folder / "scores.csv").open() as file:
        return [(int(row["step"]), row["set"]) for row in csv.DictReader(file)]


def read_curves(folder):
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    return {tag: [e.step for e in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def test_a_short_run_is_logged_and_validated_by_its_own_length(run, tmp_path):
    result = run("--set", "schedule.steps = 5", recipe=RECIPE + VALIDATION)
    assert result.exit_code == 0, result.output
    assert read_scores(tmp_path / "run") == [(step, "camvid") for step in range(1, 6)]
    assert read_curves(tmp_path / "run")["loss/total"] == list(range(1, 6))


def test_a_resumed_run_names_its_step_and_not_its_first_weights(run, tmp_path, monkeypatch):
    threads = []
    monkeypatch.setattr(torch, "set_num_threads", threads.append)
    assert run("--stop-after", "1", "--threads", "3", out="first").exit_code == 0
    assert threads == [3]
    # Without its classes something has random weights.
    classes = "model = {name = 'ssdnet-lite', classes = [{name = 'sky', color = [0, 0, 0]}]}"
    for path in (tmp_path / "camvid/trainannot").iterdir():
        cv2.imwrite(str(path), np.zeros((40, 48), np.uint8))
    options = ("--init", str(tmp_path / "first/last.pt"), "--set", classes)
    source = "{kind = 'folders', path = 'camvid', rgb = 'train', labels = 'trainannot'}"
    options += ("--set", f"data.source = [{source}]", "--set", "data.workers = 500")
    first = run(*options, "--stop-after", "2")
    assert first.exit_code == 0, first.output
    assert "with random weights: semantic_coarse_head, semantic_head" in first.stderr
    assert "resumed at" not in first.stderr
    second = run(*options, "--stop-after", "3")
    assert second.exit_code == 0, second.output
    assert "resumed at step 2 of 10" in second.stderr
    assert "random weights" not in second.stderr
    document = json.loads((tmp_path / "run/recipe.json").read_text())
    assert document["recipe"]["data"]["workers"] == 500  # no more were started than cores


def test_validation_sets_are_scored_under_their_names(run, tmp_path):
    """One folder twice, with names of its own; the default is the path."""
    both = VALIDATION + 'name = "town"\n' + VALIDATION
    options = ("--set", "schedule.steps = 1", "--set", 'validation.best = "town/miou"')
    result = run(*options, recipe=RECIPE + both)
    assert result.exit_code == 0, result.output
    assert read_scores(tmp_path / "run") == [(1, "town"), (1, "camvid")]
    assert {"validation/town/miou", "validation/camvid/miou"} <= read_curves(
        tmp_path / "run"
    ).keys()
    for twice in (VALIDATION * 2, VALIDATION + 'name = "a"\n' + VALIDATION + 'name = "a"\n'):
        result = run(recipe=RECIPE + twice)
        assert result.exit_code == 1
        title = "a" if "name" in twice else "camvid"
        assert f"source has two sets with the title '{title}'" in result.output
        assert "`name`" in result.output


def test_a_dry_run_draws_the_first_batch_and_writes_nothing_else(run, tmp_path):
    write_second_edition(tmp_path / "scenes", magnify=8)
    result = run("--dry-run", "--set", "data.source = [{kind = 'rendered', path = 'scenes'}]")
    assert result.exit_code == 0, result.output
    (path,) = (tmp_path / "run").iterdir()
    assert path.name == "batch.png"
    assert str(path) in result.stdout.splitlines()
    assert "crops of 32 x 32 px" in result.stdout
    assert re.search(r"scenes: \d+ frames, \d+% of a crop is padding", result.stdout)
    assert re.search(r"classes \(\d+% of the pixels\): sky \d+\.\d%, building", result.stdout)
    assert re.search(r"depth \([\d.]+% of .*: 1 % [\d.]+ m, 50 % [\d.]+ m, 99 %", result.stdout)
    picture = cv2.imread(str(path))
    assert picture.shape[1] == 4 * 32  # image, classes, depth, LiDAR input
    assert picture.shape[0] > 2 * 32  # two samples and the legend
    # What cannot start is refused as without --dry-run.
    for change, text in (
        ("schedule.warmup_steps = 11", "schedule.warmup_steps = 11: longer than the run of steps"),
        ("optimizer.learning_rate = 0.0", "nothing would learn: no term"),
        ("optimizer.frozen = ['']", "nothing would learn"),
        ("validation.best = 'camvid/mae_m'", "best = 'camvid/mae_m'; camvid gives miou, accuracy"),
    ):
        result = run("--dry-run", "--set", change, recipe=RECIPE + VALIDATION, out="other")
        assert result.exit_code == 1
        assert text in result.output.replace("\n", " ")
    result = run("--dry-run", "--set", "data.source = [{kind = 'camvid', path = 'x'}]", out="other")
    assert result.exit_code == 1
    assert "no folder 'x'" in result.output
    assert not (tmp_path / "other").exists()
    result = run("--dry-run", out="r.toml")
    assert result.exit_code == 1
    assert "r.toml: cannot be written" in result.output


#: A training with settings of its own, for the fine-tuning of its weights.
EARLIER = (
    RECIPE.replace("crop = [32, 32]", "crop = [96, 96], pair_shift = 16")
    + """
[model.config]
canonical_focal_px = 700.0
[loss]
depth_form = "metric"
depth_weight = 0.25
semantic_consistency_weight = 0.5
[optimizer]
learning_rate = 4e-3
frozen = ["encoder.stem"]
"""
)
#: Data and steps alone.
SHORT = "[data]" + RECIPE.split("[data]")[1]


def test_what_a_recipe_leaves_out_comes_from_the_training_of_its_first_weights(run, tmp_path):
    result = run("--set", "schedule.steps = 1", recipe=EARLIER, out="first")
    assert result.exit_code == 0, result.output
    init = ("--init", str(tmp_path / "first/model.pt"))
    line = f"from the recipe of {tmp_path}/first/model.pt: "
    for option in ("--dry-run", "--stop-after=1"):
        result = run(*init, option, recipe=SHORT, out="second")
        assert result.exit_code == 0, result.output
        assert line in result.stderr
        for text in (
            "model.name = 'ssdnet-lite'",
            "model.config.canonical_focal_px = 700.0",
            "loss.depth_form = 'metric'",
            "loss.depth_weight = 0.25",
            "optimizer.learning_rate = 0.001",
            "optimizer.frozen = ",
        ):
            assert text in result.stderr
        assert "consistency" not in result.stderr  # one view
    recipe = load_checkpoint(tmp_path / "second/last.pt").facts.recipe
    assert recipe["loss"]["depth_form"] == "metric"
    assert recipe["loss"]["semantic_consistency_weight"] == 0.0
    # The keys of the recipe come first, and another optimiser has a rate of its own.
    own = SHORT + "[loss]\ndepth_weight = 0.5\n[optimizer]\nname = 'sgd'\n"
    result = run(*init, "--stop-after=1", recipe=own, out="third")
    assert result.exit_code == 0, result.output
    recipe = load_checkpoint(tmp_path / "third/last.pt").facts.recipe
    assert recipe["loss"]["depth_weight"] == 0.5
    assert recipe["optimizer"]["name"] == "sgd"
    assert recipe["optimizer"]["learning_rate"] == 2e-3
    other = SHORT + "[model]\nname = 'ssdnet-small'\n"
    assert line not in run(*init, "--dry-run", recipe=other, out="fourth").stderr
