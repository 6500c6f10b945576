"""What a training refuses or reports before its first step."""

import os

import numpy as np
import pytest
import torch

from layouts.pictures import write
from runtime.base.errors import InputError
from training.base.processes import Processes
from training.base.tables import build, merge
from training.losses.terms import TERMS
from training.run.recipe import Recipe
from training.run.task import open_task
from training.run.training_run import TrainingRun

RECIPE = {
    "model": {
        "name": "ssdnet-lite",
        "classes": [{"name": name, "color": [0, 0, 0]} for name in ("lane", "car", "rest")],
    },
    "data": {
        "workers": 0,
        "batch_size": 2,
        "source": [{"kind": "folders", "path": "mine", "labels": "labels", "last": 5}],
    },
    "validation": {"source": [{"kind": "folders", "path": "mine", "labels": "labels", "first": 6}]},
    "schedule": {"steps": 1},
}


@pytest.fixture
def start(tmp_path, capsys, tiny_lite):
    """Open the recipe with changes for eight frames of three classes; return what is reported."""
    for index in range(8):
        ids = np.uint8([[0, 1, 2]]).repeat(48, 0).repeat(20, 1)
        write(tmp_path / f"mine/images/{index}.png", np.full((48, 60, 3), 90 + index, np.uint8))
        write(tmp_path / f"mine/labels/{index}.png", ids)
        write(tmp_path / f"mine/lidar/{index}.png", np.full((48, 60), 5 * 256, np.uint16))

    def call(changes):
        recipe = build(Recipe, merge(RECIPE, changes))
        processes = Processes(0, 1, torch.device("cpu"))
        call.task = open_task(recipe, TrainingRun([tmp_path], tmp_path / "run"), processes)
        return capsys.readouterr().err

    call.folder = tmp_path
    return call


def source(path="mine", **keys):
    return [{"kind": "folders", "path": path, "labels": "labels", **keys}]


def test_classes_that_no_pixel_shows_are_named(start):
    assert "warning" not in start({})
    for path in (start.folder / "mine/labels").iterdir():
        write(path, np.uint8([[0, 2, 255]]).repeat(48, 0).repeat(20, 1))
    err = start({})
    assert (
        "warning: no pixel of 6 frames of mine is labelled car: such a class is not trained" in err
    )


OF_LABELS = [name for name, term in TERMS.items() if term.target == "semantic"]


def test_sets_without_a_target_of_what_learns_are_refused(start):
    with pytest.raises(InputError, match="no frame of mine has a target of the loss"):
        start({"data": {"source": source(semantic_weight=0.0)}})
    with pytest.raises(InputError, match=r"has a target .* its terms depth.* need depth"):
        start({"loss": {"weights": dict.fromkeys(OF_LABELS, 0.0)}})
    # One set that has one is enough.
    both = [*source(semantic_weight=0.0), *source(name="other")]
    start({"data": {"source": both}})


def test_a_shift_smaller_than_the_cells_of_the_classes_is_refused(start):
    augment = {"crop": [96, 96], "pair_shift": 4}
    with pytest.raises(InputError, match=r"pair_shift = 4; .*'fast-scnn' are on cells of 8 px"):
        start({"model": {"name": "fast-scnn"}, "data": {"augment": augment}})


@pytest.mark.parametrize(("optimizer", "learns"), [
    ({"learning_rate": 0.0}, False), ({"learning_rate": 0.0, "encoder_rate": 0.0}, False),
    ({"learning_rate": 0.0, "encoder_rate": 1e-3}, True),
    ({"learning_rate": 0.0, "encoder_rate": 1e-3, "only": ["semantic_"]}, False),
    ({"learning_rate": 0.0, "encoder_rate": 1e-3, "frozen": ["encoder"]}, False),
    ({"encoder_rate": 0.0, "only": ["encoder"]}, False), ({"encoder_rate": 0.0}, True),
])  # fmt: skip
def test_a_part_that_is_trained_must_have_a_rate(start, optimizer, learns):
    if learns:
        start({"optimizer": optimizer})
        return
    with pytest.raises(InputError, match="nothing would learn"):
        start({"optimizer": optimizer})


@pytest.mark.parametrize(
    ("name", "changes"), [("fast-scnn", {}), ("ssdnet-lite", {"augment": {"crop": [32, 32]}})]
)
def test_batches_too_small_to_normalise_are_refused(start, name, changes):
    model = {"name": name}
    changes = {"augment": {"crop": [64, 96]}, **changes}
    with pytest.raises(InputError, match=r"batches of 1 crops of .* raise data\.batch_size"):
        start({"model": model, "data": {**changes, "batch_size": 1}})
    start({"model": model, "data": {**changes, "batch_size": 2}})


def test_a_network_that_needs_more_classes_is_refused(start, monkeypatch):
    """A network of another package may divide by what few classes make zero."""

    def divide(name, **config):
        return len(config["classes"]) // 0

    monkeypatch.setattr("training.run.network.create_model", divide)
    with pytest.raises(InputError, match=r"cannot be built with its classes.* by zero"):
        start({"model": {"name": "espnet"}})


@pytest.mark.parametrize("link", [os.symlink, os.link], ids=["symbolic", "hard"])
def test_frames_that_are_trained_on_and_validated_are_counted(start, link):
    """The files are compared, not the names that lead to them."""
    same = "5 of the 7 frames of mine are also trained on"
    assert same in start({"validation": {"source": source(first=1)}})
    (start.folder / "other/images").mkdir(parents=True)
    for index in range(4):
        for kind in ("images", "labels"):
            path = start.folder / f"other/{kind}/x{index}.png"
            path.parent.mkdir(exist_ok=True)
            link(start.folder / f"mine/{kind}/{index + 4}.png", path)
    found = start({"validation": {"source": source("other")}})
    assert "warning: 2 of the 4 frames of other are also trained on" in found


def test_a_later_frame_of_a_validation_set_may_lack_the_lidar(start):
    """The first frame has no depth, of which lines would be simulated without intrinsics."""
    (start.folder / "mine/lidar/6.png").unlink()
    validation = source(first=6, depth="lidar", missing="skip-target")
    with pytest.raises(InputError, match="mine/7 cannot be validated with the LiDAR 'own'"):
        start({"validation": {"source": validation}})


def test_a_validation_set_without_scores_is_reported(start):
    for index in (6, 7):
        write(start.folder / f"mine/labels/{index}.png", np.full((48, 60), 255, np.uint8))
    assert "warning: mine has no ground truth for a head: it gives no scores" in start({})


def test_the_smallest_frame_decides_the_crop(start):
    write(start.folder / "mine/images/3.png", np.zeros((32, 40, 3), np.uint8))
    write(start.folder / "mine/labels/3.png", np.zeros((32, 40), np.uint8))
    start({})
    assert start.task.data.augment.crop == (32, 32)
