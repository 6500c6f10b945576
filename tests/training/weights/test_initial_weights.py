"""Weights that a training starts or learns from: by path or name, and where they come from."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from export.parity import reference
from export.probe_frames import ProbeFrame
from layouts import camvid
from models import create_model, load_checkpoint, save_checkpoint
from models.training_facts import TrainingFacts
from runtime import Predictor
from runtime.base.errors import InputError
from runtime.engine.bundled_models import list_bundled_models
from runtime.recordings.bundled_stream import bundled_stream
from training.commands.train import app
from training.datasets.camvid import CamVidRecipe
from training.loading.data_recipe import DataRecipe
from training.losses import LossConfig
from training.recipes.chosen_recipe import read_stages
from training.recipes.registry import RECIPES
from training.run.network import ModelRecipe
from training.run.optimizer import ScheduleRecipe
from training.run.provenance import IMAGENET_TERMS, require_own_data, state_provenance
from training.run.recipe import Recipe, derive
from training.weights.initial_weights import (
    find_weights,
    list_weights,
    prepare_teacher,
    read_weights,
)

RECIPE = """
[data]
batch_size = 2
workers = 0
source = [{ kind = "camvid", path = "camvid" }]
augment = { crop = [192, 320], scale = [0.9, 1.1] }
[optimizer]
learning_rate = 1.5e-4
[schedule]
steps = 2
shape = "constant"
[loop]
ema_decay = 0.0
"""


def bundled_frames(step):
    rgb, depth = bundled_stream()
    for path in sorted(rgb.iterdir())[::step]:
        image = cv2.imread(str(path))[..., ::-1].copy()
        metres = cv2.imread(str(depth / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED) / 256
        yield ProbeFrame(path.stem, image, metres.astype(np.float32))


installed = pytest.mark.parametrize("name", list_weights())
bundled = pytest.mark.parametrize(
    "name", [name for name in list_weights() if name in list_bundled_models()]
)


def test_a_name_is_neither_a_slash_nor_an_ending():
    assert "ssdnet-lite" in list_weights()
    assert find_weights("ssdnet-lite").is_file()
    assert str(find_weights("ssdnet-lite.pt")) == "ssdnet-lite.pt"
    assert str(find_weights("run/ssdnet-lite")) == "run/ssdnet-lite"
    with pytest.raises(
        InputError, match=rf"unknown weights 'ssdnet'; known: {', '.join(list_weights())}:"
    ):
        find_weights("ssdnet")


@installed
def test_the_installed_weights_state_their_terms(name):
    path = find_weights(name)
    checkpoint = load_checkpoint(path)
    closed = name == "ssdnet-open"
    assert ("CC BY 4.0" if closed else "(non-commercial)") in checkpoint.facts.terms
    assert ("camvid" in checkpoint.facts.data) is not closed
    recipe = RECIPES[name.removeprefix("ssdnet-")].stages[-1].recipe
    require_own_data(recipe, init=read_weights(path))
    widths = recipe.model.network_config().to_dict()["encoder_widths"]
    assert checkpoint.model.config.encoder_widths == widths
    assert checkpoint.facts.trained_height == recipe.model.trained_height == 400
    assert path.stat().st_size < 7e6  # half precision


@installed
def test_a_recipe_of_data_and_steps_gets_the_loss_of_the_shipped_recipe(name, tmp_path):
    """The loss has all heads, although the last stages train the depth decoder alone."""
    path = tmp_path / "recipe.toml"
    path.write_text(
        "[data]\nsource = [{kind = 'camvid', path = 'camvid'}]\n[schedule]\nsteps = 100\n"
    )
    (stage,) = read_stages(str(path), init=read_weights(find_weights(name)))
    recipe = stage.recipe
    released = RECIPES[name.removeprefix("ssdnet-")].stages[-1].recipe.model
    assert recipe.model.network_config() == released.network_config()
    assert recipe.loss.depth_form == "metric"
    assert min(recipe.loss.weight(name) for name in ("depth", "semantic")) > 0
    assert recipe.optimizer.learning_rate == 5e-4  # a quarter
    assert recipe.schedule.warmup_steps == 10  # a tenth of the steps


@bundled
def test_the_installed_weights_answer_as_the_bundled_model(name):
    """Half precision moves far depth by decimetres, and changes classes where two scores tie."""
    model = load_checkpoint(find_weights(name)).model
    with Predictor(name, warmup=0, size="frame") as predictor:
        for frame in bundled_frames(step=7):
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
            expected = reference(model, frame)
            assert (prediction.semantic == expected["semantic"]).mean() > 0.9995
            difference = np.abs(prediction.depth - expected["depth"])
            assert difference.max() < 0.5
            assert difference.mean() < 0.006
            assert np.abs(prediction.boundary - expected["boundary"]).mean() < 0.002


@pytest.mark.slow
def test_two_steps_from_the_name_keep_what_was_learned(tmp_path):
    """The batch statistics are those of the layers, so training does not begin with a jolt."""
    with Predictor(warmup=0) as predictor:
        for frame in bundled_frames(step=4):
            label = predictor.predict(frame.rgb, np.zeros_like(frame.sparse_depth)).semantic
            camvid.write_frame(tmp_path / "data/camvid", frame.rgb, label, frame.name)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    run = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "run")]
    arguments = [str(tmp_path / "recipe.toml"), *run, "--init"]
    result = CliRunner().invoke(app, [*arguments, "ssdnet-lite"])
    assert result.exit_code == 0, result.output
    tuned = load_checkpoint(tmp_path / "run/model.pt").model
    start = load_checkpoint(find_weights("ssdnet-lite")).model
    assert not torch.equal(tuned.semantic_head.weight, start.semantic_head.weight)
    for frame in bundled_frames(step=9):
        camera_only = replace(frame, sparse_depth=np.zeros_like(frame.sparse_depth))
        before, now = reference(start, camera_only), reference(tuned, camera_only)
        # 0.98; with batch statistics of mean 0 and variance 1 instead, 0.3.
        assert (before["semantic"] == now["semantic"]).mean() > 0.95


STUDENT = "ssdnet-nano"
TAUGHT = LossConfig(weights={"distilled_semantic": 1.0, "distilled_depth": 1.0})


@pytest.fixture
def write(tmp_path):
    """Give a function that writes a checkpoint of these facts, of a network with changes."""

    def write(name="teacher", facts=None, **changes):
        path = tmp_path / f"{name}.pt"
        training = TrainingFacts(**(facts or {})).to_dict()
        save_checkpoint(path, create_model(STUDENT, **changes), training=training)
        return read_weights(path)

    return write


def test_a_teacher_answers_as_it_was_released_and_does_not_learn(write):
    teacher = prepare_teacher(write(), TAUGHT, create_model(STUDENT))
    assert not teacher.training
    assert not any(parameter.requires_grad for parameter in teacher.parameters())
    with pytest.raises(InputError, match=r"distilled_semantic compares .* --teacher ssdnet-lite"):
        prepare_teacher(None, TAUGHT, create_model(STUDENT))
    with pytest.raises(InputError, match="nothing would be learned"):
        prepare_teacher(write(), LossConfig(), create_model(STUDENT))


@pytest.mark.parametrize(("changes", "text"), [
    ({"classes": create_model(STUDENT).config.classes[::-1]}, "its classes is"),
    ({"max_depth_m": 80.0}, "its max_depth_m is 80.0"),
    ({"canonical_focal_px": 500.0}, "its canonical_focal_px is 500.0, that of the recipe"),
    ({"depth_head": False}, "has no head 'depth'"),
])  # fmt: skip
def test_a_teacher_whose_answers_mean_something_else_is_refused(write, changes, text):
    with pytest.raises(InputError, match=text):
        prepare_teacher(write(**changes), TAUGHT, create_model(STUDENT))


def test_weights_state_the_data_and_terms_of_all_that_they_come_from_once(write):
    source = CamVidRecipe(path="camvid")
    recipe = Recipe(
        ModelRecipe(STUDENT, pretrained="imagenet"),
        DataRecipe((source, source)),
        ScheduleRecipe(steps=1),
        terms="CamVid: research; drawn scenes: ours",
    )
    first = write("init", {"data": ("streets", "camvid"), "terms": "Streets: non-commercial"})
    terms = "drawn scenes: ours; Boston: share alike"
    teacher = write("teacher", {"data": ("boston",), "terms": terms})
    data, terms = state_provenance(recipe, first, teacher)
    assert data == ("camvid", "ImageNet", "streets", "boston")
    assert terms == (
        f"{recipe.terms}; {IMAGENET_TERMS}; Streets: non-commercial; Boston: share alike"
    )
    plain = derive(recipe, model={"pretrained": "none"})
    assert state_provenance(plain, None, None) == (("camvid",), recipe.terms)


def test_a_recipe_of_its_own_data_refuses_other_weights(write):
    recipe = Recipe(
        ModelRecipe(STUDENT), DataRecipe((CamVidRecipe(path="camvid"),)), ScheduleRecipe(steps=1)
    )
    own = write("own", {"data": ("camvid", "ImageNet")})
    mixed, unknown = write("mixed", {"data": ("camvid", "streets")}), write("unknown", {})
    require_own_data(recipe, init=mixed, teacher=unknown)
    closed = derive(recipe, own_data_only=True)
    require_own_data(closed, init=own, teacher=None)
    with pytest.raises(InputError, match=r"--init mixed\.pt: was trained on streets, whose terms"):
        require_own_data(closed, init=mixed, teacher=None)
    with pytest.raises(InputError, match=r"--teacher unknown\.pt: was trained on unknown data"):
        require_own_data(closed, init=own, teacher=unknown)


def test_weights_of_the_recipe_open_state_what_may_be_shipped_and_nothing_else(write):
    facts = {"data": ("ImageNet",)}
    for stage in RECIPES["open"].stages:
        before = write(stage.folder, facts)
        require_own_data(stage.recipe, init=before)
        data, terms = state_provenance(stage.recipe, before)
        facts = {"data": data, "terms": terms}
    street, rendered, imagenet = write("released", facts).facts.terms.split("; ")
    assert street.startswith("PandaSet (sequence 002, images reduced to 800 x 450, ")
    assert "Scale AI and Hesai, https://pandaset.org, CC BY 4.0, https://creativecommons" in street
    assert (rendered, imagenet) == ("rendered scenes: this project's, Apache-2.0", IMAGENET_TERMS)
    assert {title.partition("/")[0] for title in data} == {
        "pandaset_street",
        "rendered",
        "ImageNet",
    }
    assert "pandaset_street/right" not in data
