"""Recipes are read strictly: a typing mistake never trains silently."""

import pytest

from runtime.errors import InputError
from training.datasets.cityscapes import CityscapesRecipe
from training.recipe import AnySource, build, parse_source, read_recipe

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
    assert recipe.validation.lidar == "own"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ('name = "foo"', "model.name: unknown model 'foo'; known: ssdnet, .*"),
        ("config.max_depth_m = -1", "model.config: max_depth_m .*metres.*"),
        (
            "config.nonsense = 1",
            "model.config: not configuration fields of the network .*: nonsense",
        ),
        *(
            (f"config.canonical_focal_px = {focal}", "model.config: canonical_focal_px .*pixels.*")
            for focal in ("0", "0.5", "-700.0", "2e6")
        ),
        ("config.canonical_focal_px = nan", "model.config: canonical_focal_px .*"),
    ],
)
def test_a_network_that_cannot_be_built_is_refused_as_it_is_read(tmp_path, change, text):
    assert read(tmp_path, MINIMAL).model.config == {}
    with pytest.raises(InputError, match=text):
        read_recipe(tmp_path / "r.toml", [f"model.{change}"])
    focal = read_recipe(tmp_path / "r.toml", ["model.config.canonical_focal_px = 721.5"])
    assert focal.model.network_config().canonical_focal_px == 721.5


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("batch_size = 4", "batchsize = 4", "unknown key data.batchsize"),
        ("batch_size = 4", 'batch_size = "4"', "data.batch_size = '4': .*valid integer"),
        ("steps = 10", "", "missing key schedule.steps"),
        ("steps = 10", "steps = 10\n[loss]\nunknown = 1", "unknown key loss.unknown"),
        (
            'kind = "camvid"',
            'kind = "kitty"',
            r"data.source\[0\] = .*tag 'kitty' .* expected tags: 'camvid', 'cityscapes'",
        ),
        ("scale = [1, 2]", "scale = [1]", r"missing key data.source\[0\].scale\[1\]"),
        ("scale = [1, 2]", "scale = [1, 2, 3]", r"scale = \[1, 2, 3\]: .* at most 2 items"),
        ("scale = [1, 2]", "scale = [2, 1]", r"scale = \[2, 1\]: .*expected low <= high"),
        ("scale = [1, 2]", "size = [1.5, 64]", r"size\[0\] = 1.5: .*valid integer"),
        ("scale = [1, 2]", "size = 5", r"source\[\d\]\.size = 5: "),
        ('kind = "camvid"', "", r"data\.source\[0\] = .*'kind'"),
        ('path = "camvid"', "", r"missing key data\.source\[0\]\.path"),
        ('path = "camvid"', 'path = ""', r"data\.source\[0\]\.path = '': "),
        ('path = "camvid"', "path = 1999-12-31", "expected text, numbers, true or false"),
        ("scale = [1, 2]", "scale = [1,", "not valid TOML"),
        ("steps = 10", "steps = 10\n[loop]\ncheckpoint_every = 0", "loop.checkpoint_every = 0"),
        ("steps = 10", "steps = 10\n[optimizer]\nlearning_rate = -1", "optimizer.learning_rate"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, text):
    with pytest.raises(InputError, match=text):
        read(tmp_path, MINIMAL.replace(old, new))


BASE = """
[model]
name = "ssdnet"
[model.config]
max_depth_m = 80
[data]
batch_size = 4
seed = 5
[[data.source]]
kind = "camvid"
path = "camvid"
[[data.source]]
kind = "kitti-stream"
path = "kitti_stream"
[schedule]
steps = 10
"""


@pytest.fixture
def base(tmp_path):
    (tmp_path / "base.toml").write_text(BASE)
    return tmp_path


def test_changes_come_last_and_in_order(base):
    recipe = read_recipe(
        base / "base.toml",
        [
            "data.seed = 7",
            "data.seed = 8",
            'model = {name = "ssdnet-lite"}',
            "data.augment.crop = [64, 96]",
            'data.source = [{kind = "cityscapes", path = "c", size = [64, 128]}]',
        ],
    )
    assert recipe.data.seed == 8
    assert (recipe.model.name, recipe.model.config) == ("ssdnet-lite", {"max_depth_m": 80})
    assert recipe.data.augment.crop == (64, 96)
    assert recipe.data.source == (CityscapesRecipe(path="c", size=(64, 128)),)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("model.name = ssdnet", "'model.name = ssdnet' is not .* text needs quotes"),
        ("model.name", "is not 'table.key = value'"),
        ("model.nam = 'ssdnet'", r"r\.toml: unknown key model\.nam"),
        ("data.batch_size = 0", r"r\.toml: data\.batch_size = 0"),
        ("model = 3", "model = 3: Input should be an object"),
        ("data.source.path = 'camvid'", "data.source = .*: Input should be a valid array"),
        ("base = 'base.toml'", "unknown key base"),
    ],
)
def test_mistaken_changes_are_named(tmp_path, change, text):
    (tmp_path / "r.toml").write_text(MINIMAL)
    with pytest.raises(InputError, match=text):
        read_recipe(tmp_path / "r.toml", [change])


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        ("camvid", {"first": 1}),
        ("camvid", {"scenes": ("Scene01",)}),
        ("kitti-stream", {"cameras": (3,)}),
        ("rendered", {"split": "val"}),
    ],
)
def test_keys_that_mean_nothing_to_a_kind_are_refused(kind, keys):
    (key,) = keys
    with pytest.raises(InputError, match=rf"unknown key {key}; known here: kind, path, weight"):
        build(AnySource, {"kind": kind, "path": "folder", **keys})


def test_validation_names_its_lidar(tmp_path):
    assert read(tmp_path, MINIMAL + '[validation]\nlidar = "random:0.05"\n').validation.lidar
    with pytest.raises(InputError, match=r"validation\.lidar = '63': .*divides 64, random:SHARE"):
        read(tmp_path, MINIMAL + '[validation]\nlidar = "63"\n')


@pytest.mark.parametrize(
    ("steps", "every"),
    [(1, (1, 1, 1)), (300, (3, 30, 60)), (2000, (20, 200, 400)), (60000, (20, 500, 1000))],
)
def test_output_follows_the_number_of_steps_unless_stated(tmp_path, steps, every):
    recipe = read(tmp_path, MINIMAL.replace("steps = 10", f"steps = {steps}"))
    assert (recipe.log_every, recipe.checkpoint_every, recipe.validate_every) == every
    changes = ["loop.log_every = 7", "loop.checkpoint_every = 9000", "validation.every = 8000"]
    stated = read_recipe(tmp_path / "r.toml", changes)
    assert (stated.log_every, stated.checkpoint_every, stated.validate_every) == (7, 9000, 8000)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("data.workers = 1000000", "data.workers = 1000000: .*less than or equal to"),
        (
            "data.augment = {crop = [9000, 9000], scale = [1.0, 1.0]}",
            "batch_size = 4: .* 9000x9000",
        ),
        ("data.batch_size = 60000", "batch_size = 60000: .* more than 268435456 pixels"),
        ("data.augment.crop = [100000, 320]", r"augment.crop\[0\] = 100000: "),
        ("data.augment.scale = [1e-9, 1.0]", r"augment.scale\[0\] = 1e-09: "),
        ("data.augment.scale = [0.02, 1.0]", "augment.scale: at 0.02 a crop of 320x480 is cut"),
        (
            "data.source = [{kind = 'camvid', path = 'a', scale = [0.02, 1.0]}]",
            "augment.scale: at 0.02 a crop",
        ),
        ("schedule.steps = 99000000", "schedule.steps = 99000000: .* 396000000 samples"),
        ("data.augment.brightness = nan", "augment.brightness = nan: .*finite"),
        ("schedule.steps = 1000000000000", "schedule.steps = 1000000000000: "),
        ("loss.depth_weight = inf", "loss.depth_weight = inf: .*finite"),
        (f"terms = '{'x' * 20_000}'", r"terms = 'x{199}…: "),
        ("data.source = [{kind = 'camvid', path = 'a', size = [100000, 64]}]", r"size\[0\] = 1000"),
    ],
    ids=lambda text: text[:40],
)
def test_oversized_values_are_refused_before_anything_is_allocated(base, change, text):
    with pytest.raises(InputError, match=text):
        read_recipe(base / "base.toml", [change])


def test_the_score_of_the_best_weights_is_of_a_validation_set(base):
    sets = "validation.source = [{kind = 'camvid', path = 'r/val', split = 'val'}]"
    best = read_recipe(base / "base.toml", [sets, "validation.best = 'r/val/miou'"])
    assert best.validation.best == "r/val/miou"
    for name in ("miou", "camvid/miou"):
        with pytest.raises(InputError, match=rf"validation\.best = '{name}'; expected SET/SCORE"):
            read_recipe(base / "base.toml", [sets, f"validation.best = '{name}'"])


def test_losses_of_consistency_need_two_views(base):
    weight = "loss.depth_consistency_weight = 1.0"
    with pytest.raises(InputError, match=r"depth_consistency_weight .*pair_shift"):
        read_recipe(base / "base.toml", [weight])
    shift = "data.augment.pair_shift = 32"
    assert read_recipe(base / "base.toml", [weight, shift]).data.augment.pair_shift == 32
    with pytest.raises(InputError, match="would not overlap inside their borders"):
        read_recipe(base / "base.toml", [shift, "data.augment.crop = [96, 320]"])


@pytest.mark.parametrize(
    "change",
    [
        "optimizer.learning_rate = inf",
        "loop.ema_decay = 3.0",
        "data.augment.scale = [0.0, 1.0]",
        "data.augment.random_share = [2.0, 2.0]",
        "data.augment.lines = [5]",
        "data.augment.pair_shift = 5",
        "data.augment.pair_lidar_false = 1.5",
    ],
)
def test_values_out_of_range_are_refused_by_name(base, change):
    key = change.split(" = ")[0].split(".")[-1]
    with pytest.raises(InputError, match=rf"{key}(\[\d\])? = "):
        read_recipe(base / "base.toml", [change])


@pytest.mark.parametrize(
    ("key", "name"), [("data.sky_depth_m", "sky"), ("loss.road_weight", "road")]
)
def test_what_is_of_a_class_needs_a_class_of_that_name(base, key, name):
    named = read_recipe(base / "base.toml", [f"{key} = 1.0", "model.classes = 'virtual_kitti'"])
    assert named.model.class_id(name) is not None  # there it is written "Sky"
    own = "model.classes = [{name = 'a', color = [0, 0, 0]}]"
    with pytest.raises(InputError, match=rf"{key} needs a class called '{name}'"):
        read_recipe(base / "base.toml", [f"{key} = 1.0", own])


def test_rare_classes_are_classes_of_the_model(tmp_path):
    text = MINIMAL.replace("batch_size = 4", "batch_size = 4\nrare_classes = ['pole', 'Sign']")
    assert read(tmp_path, text).rare_ids == (2, 6)
    with pytest.raises(
        InputError, match=r"data\.rare_classes: 'sing' is not a class of model.classes"
    ):
        read(tmp_path, text.replace("Sign", "sing"))
    with pytest.raises(InputError, match=r"augment\.rare_crops needs rare_classes"):
        read(tmp_path, MINIMAL + "[data.augment]\nrare_crops = 0.5")


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("folders:x,name=2011_09_26", "name", "2011_09_26"),
        ("folders:x,name=2011-09-26", "name", "2011-09-26"),
        ("folders:x,labels=0001", "labels", "0001"),
        ("folders:x,labels=1e3", "labels", "1e3"),
        ("folders:x,name=true", "name", "true"),
        ('folders:x,name="a b"', "name", "a b"),
        ("folders:x,depth_scale=1000", "depth_scale", 1000),
        ("folders:x,last=7", "last", 7),
        ("folders:x,size=400", "size", 400),
        ("folders:x,size=[400, 640]", "size", (400, 640)),
        ("folders:2011-09-26", "path", "2011-09-26"),
        (
            'kitti-raw:x,drives=["2011_09_26_drive_0001_sync"]',
            "drives",
            ("2011_09_26_drive_0001_sync",),
        ),
    ],
)
def test_a_value_of_data_is_text_where_its_key_takes_text(text, key, value):
    assert getattr(parse_source(text), key) == value
