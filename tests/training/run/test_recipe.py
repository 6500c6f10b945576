"""Recipes are read strictly: a typing mistake never trains silently."""

import pytest

from runtime.base.errors import InputError
from training.base.tables import build
from training.datasets.cityscapes import CityscapesRecipe
from training.datasets.registry import AnySource, parse_data
from training.recipes.chosen_recipe import read_stages

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


@pytest.fixture
def read(tmp_path):
    """Give a function that reads a recipe with changes."""

    def read(*changes, text=MINIMAL):
        (tmp_path / "r.toml").write_text(text)
        (stage,) = read_stages(str(tmp_path / "r.toml"), changes)
        return stage.recipe

    return read


def test_changes_come_last_and_in_order(read):
    assert read().data.source[0].scale == (1.0, 2.0)
    recipe = read(
        "data.seed = 7",
        "data.seed = 8",
        "model.config.max_depth_m = 80",
        'model = {name = "ssdnet-small"}',
        "data.augment.crop = [64, 96]",
        'data.source = [{kind = "cityscapes", path = "c", size = [64, 128]}]',
    )
    assert recipe.data.seed == 8
    assert (recipe.model.name, recipe.model.config) == ("ssdnet-small", {"max_depth_m": 80})
    assert recipe.model.network_config().max_depth_m == 80
    assert recipe.data.augment.crop == (64, 96)
    assert recipe.data.source == (CityscapesRecipe(path="c", size=(64, 128)),)
    assert recipe.data.batch_size == 4


@pytest.mark.parametrize(("old", "new", "text"), [
    ("batch_size = 4", "batchsize = 4", "unknown key data.batchsize; known here: source, aug"),
    ("batch_size = 4", 'batch_size = "4"', "data.batch_size = '4': "),
    ("steps = 10", "", "missing key schedule.steps"),
    ("steps = 10", "steps = 10\n[loss]\nunknown = 1", "unknown key loss.unknown"),
    (
        'kind = "camvid"',
        'kind = "kitty"',
        r"data.source\[0\]: unknown kind .*'kitty': give one of .*cityscapes",
    ),
    ("scale = [1, 2]", "scale = [1]", r"missing key data.source\[0\].scale\[1\]"),
    ("scale = [1, 2]", "scale = [2, 1]", r"data.source\[0\].scale = \[2, 1\]: "),
    ("scale = [1, 2]", "size = [1.5, 64]", r"source\[0\].size\[0\] = 1.5: "),
    ("scale = [1, 2]", "size = 5", r"source\[0\]\.size = 5: "),
    ('path = "camvid"', "path = 1999-12-31", "write text, numbers, true or false"),
    ("scale = [1, 2]", "scale = [1,", "not valid TOML"),
])  # fmt: skip
def test_mistakes_are_named(read, old, new, text):
    with pytest.raises(InputError, match=text):
        read(text=MINIMAL.replace(old, new))


CLASS, SET = "{name = 'a', color = [0, 0, 0]}", "{kind = 'camvid', path = 'r/val', split = 'val'}"
OWN_CLASSES, VALIDATION = f"model.classes = [{CLASS}]", f"validation.source = [{SET}]"


@pytest.mark.parametrize(("changes", "text"), [
    (["model.name = ssdnet"], "'model.name = ssdnet' is not .* put text in quotes"),
    (["model.nam = 'ssdnet'"], r"r\.toml: unknown key model\.nam"), (["model = 3"], "model = 3: "),
    (["model.name = 'foo'"], "model.name: unknown model 'foo'; known: ssdnet, "),
    (["model.config.max_depth_m = -1"], "model.config: max_depth_m "),
    (["model.config.nonsense = 1"], "model.config: .*: nonsense"),
    (["model.config.canonical_focal_px = nan"], "model.config: canonical_focal_px "),
    (["model.config.classes = []"], "config has 'classes', which is a separate key"),
    ([f"model.classes = [{CLASS}, {CLASS}]"], "has 'a' and 'a'"),
    (["data.batch_size = 0"], r"r\.toml: data\.batch_size = 0"),
    (["data.augment.crop = [9, 64]"], r"augment.crop = \[9, 64\]"),
    (["data.augment.crop = [100000, 320]"], r"augment.crop\[0\] = 100000: "),
    (["data.augment.lines = [5]"], r"augment.lines\[0\] = 5: "),
    (["data.augment.pair_shift = 5"], "augment.pair_shift = 5: "),
    (["data.augment.pair_shift = 32", "data.augment.crop = [96, 320]"], "would not overlap"),
    (["loss.weights.depth_consistency = 1.0"], "weights.depth_consistency .*pair_shift"),
    (["loss.depth_weight = inf"], "loss.weights.depth = inf: "),
    (["schedule.warmup_steps = 11"], "schedule.warmup_steps = 11"),
    ([f"terms = '{'x' * 20_000}'"], r"terms = 'x{199}…: "),
    (["validation.lidar = '63'"], r"validation\.lidar = '63': .*divides 64, random:SHARE"),
    ([VALIDATION, "validation.best = 'camvid/miou'"], "best = 'camvid/miou'; .*SET/SCORE"),
    ([f"validation.source = [{SET}, {SET}]"], "two sets with the title 'r/val'"),
    (["data.rare_classes = ['sing']"], r"data\.rare_classes: 'sing' is not a class"),
    (["data.augment.rare_crops = 0.5"], r"augment\.rare_crops needs rare_classes"),
    ([OWN_CLASSES, "data.sky_depth_m = 1.0"], "sky_depth_m needs a class called 'sky'"),
    ([OWN_CLASSES, "loss.weights.road = 1.0"], "weights.road needs a class called 'road'"),
], ids=lambda value: value[:40] if isinstance(value, str) else None)  # fmt: skip
def test_mistaken_changes_are_named(read, changes, text):
    with pytest.raises(InputError, match=text):
        read(*changes)


def test_what_belongs_together_is_accepted(read):
    recipe = read(
        VALIDATION,
        "validation.best = 'r/val/miou'",
        "model.classes = 'virtual_kitti'",
        "data.sky_depth_m = 1.0",
        "loss.weights.road = 1.0",
        "data.augment.pair_shift = 32",
        "loss.weights.depth_consistency = 1.0",
        "data.rare_classes = ['pole', 'Sky']",
    )
    assert recipe.model.class_id("sky") is not None  # there it is written "Sky"
    assert len(recipe.rare_ids) == 2


@pytest.mark.parametrize(("kind", "keys"), [
    ("camvid", {"first": 1}), ("kitti-stream", {"cameras": (3,)}), ("rendered", {"split": "val"}),
])  # fmt: skip
def test_keys_that_mean_nothing_to_a_kind_are_refused(kind, keys):
    (key,) = keys
    with pytest.raises(InputError, match=rf"unknown key {key}; known here: kind, path, weight"):
        build(AnySource, {"kind": kind, "path": "folder", **keys})


@pytest.mark.parametrize(("steps", "every"), [
    (1, (1, 1, 1)), (300, (3, 30, 60)), (2000, (20, 200, 400)), (60000, (20, 500, 1000)),
])  # fmt: skip
def test_output_follows_the_number_of_steps_unless_stated(read, steps, every):
    recipe = read(f"schedule.steps = {steps}")
    assert (recipe.log_every, recipe.checkpoint_every, recipe.validate_every) == every
    stated = read("loop.log_every = 7", "loop.checkpoint_every = 9000", "validation.every = 8000")
    assert (stated.log_every, stated.checkpoint_every, stated.validate_every) == (7, 9000, 8000)


@pytest.mark.parametrize(("text", "key", "value"), [
    ("folders:x,name=2011_09_26", "name", "2011_09_26"),
    ("folders:x,name=2011-09-26", "name", "2011-09-26"), ("folders:x,labels=1e3", "labels", "1e3"),
    ('folders:x,name="a b"', "name", "a b"), ("folders:x,depth_scale=1000", "depth_scale", 1000),
    ("folders:x,size=[400, 640]", "size", (400, 640)), ("folders:2011-09-26", "path", "2011-09-26"),
    ("kitti-depth:x,cameras=[3]", "cameras", (3,)),
])  # fmt: skip
def test_a_value_of_data_is_text_where_its_key_takes_text(text, key, value):
    assert getattr(parse_data(text), key) == value
