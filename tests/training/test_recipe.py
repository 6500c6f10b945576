"""Recipes are read strictly: a typing mistake never trains silently."""

from importlib import resources

import pytest

from runtime.errors import InputError
from training.recipe import SourceRecipe, ValidationRecipe, read_recipe

MINIMAL = """
[model]
name = "ssdnet-lite"
[data]
batch_size = 4
[[data.source]]
kind = "camvid"
path = "camvid"
scale = [1, 2]
[schedule]
steps = 10
"""


def read(tmp_path, text):
    path = tmp_path / "r.toml"
    path.write_text(text)
    return read_recipe(path)


def test_defaults_and_conversions(tmp_path):
    recipe = read(tmp_path, MINIMAL)
    assert recipe.data.batch_size == 4
    assert recipe.data.source[0].scale == (1.0, 2.0)
    assert recipe.optimizer.name == "adamw"
    assert recipe.validation.source == ()


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("batch_size = 4", "batchsize = 4", "unknown key data.batchsize"),
        ("batch_size = 4", 'batch_size = "4"', "data.batch_size = '4' has the wrong type"),
        ("batch_size = 4", "batch_size = true", "wrong type"),
        ("steps = 10", "", "missing key schedule.steps"),
        ("steps = 10", "steps = 10\n[loss]\nunknown = 1", "unknown key loss.unknown"),
        ('kind = "camvid"', 'kind = "kitty"', "choose one of 'camvid'"),
        ("scale = [1, 2]", "scale = [1]", "needs 2 values"),
        ("scale = [1, 2]", "scale = [1,", "not valid TOML"),
        ("steps = 10", "steps = -5", "schedule.steps = -5"),
        ("batch_size = 4", "batch_size = 0", "data.batch_size = 0"),
        ("scale = [1, 2]", "weight = -0.7", "must be positive"),
        ("steps = 10", "steps = 10\n[loop]\ncheckpoint_every = 0", "loop.checkpoint_every = 0"),
        ("steps = 10", "steps = 10\n[optimizer]\nlearning_rate = -1", "optimizer.learning_rate"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, text):
    with pytest.raises(InputError, match=text):
        read(tmp_path, MINIMAL.replace(old, new))


def test_file_that_is_not_text(tmp_path):
    (tmp_path / "r.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        read_recipe(tmp_path / "r.toml")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_recipe(tmp_path / "none.toml")


@pytest.mark.parametrize(
    "name", [p.name for p in resources.files("training.recipes").iterdir() if p.suffix == ".toml"]
)
def test_shipped_recipes_are_valid(name):
    with resources.as_file(resources.files("training.recipes") / name) as path:
        assert read_recipe(path).schedule.steps > 0


def test_two_validation_sets_of_one_path_are_refused():
    source = SourceRecipe("camvid", "camvid", split="val")
    with pytest.raises(ValueError, match="'camvid' twice"):
        ValidationRecipe(source=(source, source))
    with pytest.raises(ValueError, match=r"validation\.every"):
        ValidationRecipe(every=0)
