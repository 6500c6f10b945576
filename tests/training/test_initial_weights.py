"""The weights that a training starts from: by path or name, and what the installed ones do."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from export.parity import reference
from export.probe_frames import ProbeFrame
from layouts import camvid
from models import load_checkpoint
from models.registry import NETWORKS
from runtime import Predictor
from runtime.bundled_models import list_bundled_models
from runtime.errors import InputError
from runtime.sources.bundled_stream import bundled_stream
from training import cli
from training.chosen_recipe import read_stages
from training.initial_weights import find_weights, list_weights, read_weights
from training.recipes.registry import RECIPES

RECIPE = """
[data]
batch_size = 4
workers = 0
source = [{ kind = "camvid", path = "camvid" }]
augment = { crop = [192, 320], scale = [0.9, 1.1] }
[optimizer]
learning_rate = 1.5e-4
[schedule]
steps = 4
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
        InputError, match=rf"unknown weights 'ssdnet'; known: {', '.join(list_weights())}\."
    ):
        find_weights("ssdnet")


@installed
def test_the_installed_weights_state_their_terms(name):
    path = find_weights(name)
    checkpoint = load_checkpoint(path)
    assert "non-commercial" in checkpoint.facts.terms
    assert "camvid" in checkpoint.facts.data
    recipe = RECIPES[name.removeprefix("ssdnet-")].stages[-1].recipe
    widths = NETWORKS[recipe.model.name].config.encoder_widths
    assert checkpoint.model.config.encoder_widths == widths
    assert checkpoint.facts.trained_height == recipe.model.trained_height == 400
    assert path.stat().st_size < 7e6  # half precision


@installed
def test_a_recipe_of_data_and_steps_gets_the_loss_of_the_shipped_recipe(name, tmp_path):
    """Of all heads: the last stages train the depth decoder alone."""
    path = tmp_path / "recipe.toml"
    path.write_text(
        "[data]\nsource = [{kind = 'camvid', path = 'camvid'}]\n[schedule]\nsteps = 100\n"
    )
    (stage,) = read_stages(str(path), init=read_weights(find_weights(name)))
    recipe = stage.recipe
    assert recipe.model.name == name
    assert recipe.model.config == {"canonical_focal_px": 721.5}
    assert recipe.loss.depth_form == "metric"
    assert min(recipe.loss.depth_weight, recipe.loss.semantic_weight) > 0
    assert recipe.optimizer.learning_rate == 5e-4  # a quarter
    assert recipe.schedule.warmup_steps == 10  # a tenth of the steps


@bundled
def test_the_installed_weights_answer_as_the_bundled_model(name):
    """Half precision moves depth by decimetres far away, classes where two of them tie."""
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
def test_four_steps_from_the_name_keep_what_was_learned(tmp_path):
    """The batch statistics are those of the layers, so training does not begin with a jolt."""
    with Predictor(warmup=0) as predictor:
        for frame in bundled_frames(step=4):
            label = predictor.predict(frame.rgb, np.zeros_like(frame.sparse_depth)).semantic
            camvid.write_frame(tmp_path / "data/camvid", frame.rgb, label, frame.name)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    run = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "run")]
    arguments = [str(tmp_path / "recipe.toml"), *run, "--init"]
    result = CliRunner().invoke(cli.app, [*arguments, "ssdnet-lite"])
    assert result.exit_code == 0, result.output
    tuned = load_checkpoint(tmp_path / "run/model.pt").model
    start = load_checkpoint(find_weights("ssdnet-lite")).model
    assert not torch.equal(tuned.semantic_head.weight, start.semantic_head.weight)
    for frame in bundled_frames(step=9):
        camera_only = replace(frame, sparse_depth=np.zeros_like(frame.sparse_depth))
        before, now = reference(start, camera_only), reference(tuned, camera_only)
        # 0.98; with batch statistics of mean 0 and variance 1 instead, 0.3.
        assert (before["semantic"] == now["semantic"]).mean() > 0.95
