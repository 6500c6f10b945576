"""`ssdnet-finetune`: the recipe that it makes for folders, and what it refuses."""

import re
import shutil
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from layouts.pictures import write
from models import SSDNetLite, load_checkpoint, save_checkpoint
from training.commands import finetune
from training.commands.train import app


@pytest.fixture(scope="module")
def written(tmp_path_factory, tiny_config):
    """Twenty images whose left half is a lane 5 m away, and weights trained on 50 rows."""
    folder = tmp_path_factory.mktemp("mine")
    save_checkpoint(folder / "first.pt", SSDNetLite(tiny_config), training={"trained_height": 50})
    rng = np.random.default_rng(0)
    ids = np.repeat(np.uint8([[0, 1]]), 48, 0).repeat(32, 1)
    for index in range(20):
        name = f"{index:02}"
        image = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        write(folder / "images" / f"{name}.jpg", image)
        write(folder / "labels" / f"{name}.png", ids)
        write(folder / "lidar" / f"{name}.png", np.full((48, 64), 5 * 256, np.uint16) * ids)
    (folder / "classes.txt").write_text("lane\nrest\n\n")
    return folder


@pytest.fixture
def mine(written, tmp_path, tiny_lite):
    return Path(shutil.copytree(written, tmp_path, dirs_exist_ok=True))


STEPS = ("--set", "schedule.steps = 2", "--set", "data.workers = 0")


def train(folder, *further, **changes):
    options = {"init": "first.pt", "images": "images", "labels": "labels", "out": "run"}
    options |= {"classes": "classes.txt", **changes}
    images = str(folder / options.pop("images"))
    given = [(f"--{key}", str(folder / name)) for key, name in options.items() if name]
    return CliRunner().invoke(finetune.app, [images, *sum(given, ()), *further])


def test_a_class_that_is_ignored_is_not_learned(mine):
    result = train(mine, "--dry-run", "--ignore", "Lane", "--set", "data.workers = 0")
    assert result.exit_code == 0, result.output
    text = (mine / "run/recipe.toml").read_text()
    assert 'label_ids = { 0 = "ignore", 1 = "rest" }' in text
    assert 'name = "lane"' not in text
    assert "rest 100" in result.stdout
    for given, expected in (
        ("tree", "--ignore tree: is no class of"),
        ("rest", "no class is left"),
    ):
        refused = train(mine, "--dry-run", "--ignore", "lane", "--ignore", given)
        assert refused.exit_code == 1
        assert expected in refused.stderr


def changed_layers(folder):
    """Names of what the run made of the first weights."""
    before, after = (
        load_checkpoint(folder / name).model.state_dict() for name in ("first.pt", "run/model.pt")
    )
    return {
        name
        for name, value in before.items()
        if value.shape != after[name].shape or not value.equal(after[name])
    }


def test_a_recipe_is_made_for_the_folders_and_trained(mine):
    result = train(mine, *STEPS, depth="lidar")
    assert result.exit_code == 0, result.output
    text = (mine / "run/recipe.toml").read_text()
    assert text in result.stderr
    assert 'only = ["semantic_"]' in text
    assert "# --set schedule.steps = 2\n" in text
    changed = changed_layers(mine)
    assert {name.split(".")[0] for name in changed} == {
        "semantic_head",
        "semantic_coarse_head",
        "semantic_refine",
    }
    facts = load_checkpoint(mine / "run/model.pt").facts
    assert facts.trained_height == 48
    assert [item["name"] for item in facts.recipe["model"]["classes"]] == ["lane", "rest"]
    (trained,), (held_out,) = (facts.recipe[key]["source"] for key in ("data", "validation"))
    assert trained["parts"] == ((0, 3), (6, 9), (12, 17))
    assert held_out["parts"] == ((4, 5), (10, 11), (18, 19))
    assert re.search(r"val/miou +[\d.]+ +[\d.]+\nval/mae_m +[\d.]+ +[\d.]+\n", result.stderr)
    # The same command resumes; its files beside the images are not those of the data.
    resumed = train(mine, *STEPS, depth="lidar")
    assert resumed.exit_code == 0, resumed.output
    assert "warning" not in resumed.stderr
    assert f"all 2 steps of {mine / 'run'} are done" in resumed.stderr
    page = (mine / "run/validation.html").read_text()
    assert page.count("mIoU % during the training") >= 1
    # What was trained, with its changes, is a recipe like any other.
    written = tomllib.loads((mine / "run/recipe.toml").read_text())
    assert (written["schedule"]["steps"], written["data"]["workers"]) == (2, 0)
    more = train(mine, "--set", "schedule.steps = 3", depth="lidar")
    assert "the run is finished: train on from it, --init" in more.stderr
    command = [mine / "run/recipe.json", "--data", mine, "--init", mine / "first.pt"]
    again = CliRunner().invoke(app, [*map(str, command), "--out", str(mine / "same")])
    assert again.exit_code == 0, again.output
    weights, same = (load_checkpoint(mine / run / "model.pt").model for run in ("run", "same"))
    for first, second in zip(
        weights.state_dict().values(), same.state_dict().values(), strict=True
    ):
        assert first.equal(second)
    command = [mine / "run/recipe.toml", "--data", mine, "--init", mine / "first.pt", "--dry-run"]
    again = CliRunner().invoke(app, [*map(str, command), "--out", str(mine / "again")])
    assert again.exit_code == 0, again.output
    assert "train: 14 frames" in again.stdout
    # Other folders give another recipe, which does not replace it.
    other = train(mine)
    assert other.exit_code == 1
    assert "run/recipe.toml: is not the recipe that these folders give now" in other.stderr
    assert (mine / "run/recipe.toml").read_text() == text


def test_without_labels_only_what_the_depth_alone_reads_is_trained(mine):
    result = train(mine, *STEPS, labels="", classes="", depth="lidar")
    assert result.exit_code == 0, result.output
    changed = changed_layers(mine)
    assert {name.split(".")[0] for name in changed} == {"depth_decoder", "surface_depth"}
    assert not any(name.startswith("surface_depth.embed") for name in changed)


def test_a_dry_run_shows_the_recipe(mine):
    """The images are of a larger camera, and are resized to the rows of the first weights."""
    for path in (*mine.glob("images/*"), *mine.glob("labels/*")):
        assert cv2.imwrite(str(path), cv2.imread(str(path), -1).repeat(2, 0).repeat(2, 1))
    result = train(mine, "--dry-run")
    assert result.exit_code == 0, result.output
    assert "size = 50\n" in result.stderr
    assert "steps = 70" in result.stderr
    assert "lidar" not in result.stderr
    assert {path.name for path in (mine / "run").iterdir()} == {"batch.png", "recipe.toml"}


@pytest.mark.parametrize(("rows", "found"), [
    ([40], "trained_height = 48"),  # runs at its own size
    ([70], "size = 48\n"),  # the engine would run it at 48 rows
    ([34], "size = 48\n"),
    ([97, 40, 23], "warning: .* 2 of 20 images .* the 48 rows of the others, such as 97; all"),
    ([97, 97, 97], "error: .* 3 of 20 images .* such as 97: train on a folder of each size"),
])  # fmt: skip
def test_images_of_other_sizes_keep_their_aspect(mine, rows, found):
    """The first image, which is narrow, does not speak for the others."""
    for index, height in enumerate(rows):
        for path in (mine / f"images/{index:02}.jpg", mine / f"labels/{index:02}.png"):
            image = cv2.resize(cv2.imread(str(path), -1), (40, height), interpolation=0)
            assert cv2.imwrite(str(path), image)
    result = train(mine, "--dry-run", "--set", "data.augment.crop = [32, 32]")
    assert re.search(found, result.output), result.output
    assert result.exit_code == found.startswith("error")
    assert ("\nsize = 48\n" in result.stderr) == found.startswith(("size", "warning"))


@pytest.mark.parametrize(("units", "camera", "beyond", "remedy"), [
    (256, (), "", ""), (60 * 256, (), "100 m", "check the unit (depth_scale"),
    (256, ("--focal-length", "20", "--set", "model.config.canonical_focal_px = 1e3"), "2 m",
     "set model.config.farthest_guess_m = 200 to train it, or check the focal length"),
    (60 * 256, ("--set", "model.config.max_depth_m = 400"), "100 m",
     "set model.config.farthest_guess_m = 400"),
])  # fmt: skip
def test_depth_beyond_the_range_is_reported(mine, units, camera, beyond, remedy):
    for path in mine.glob("lidar/*"):
        assert cv2.imwrite(str(path), np.full((48, 64), 4 * units, np.uint16))
    result = train(mine, "--dry-run", *camera, depth="lidar")
    assert result.exit_code == 0, result.output
    text = f"warning: train: 100% of the depth is beyond {beyond} and not trained: {remedy}"
    assert (text in result.stderr) == bool(beyond), result.stderr
    alone = train(mine, "--dry-run", *camera, depth="lidar", labels=None, classes=None, out="alone")
    assert ("no frame of train has a target of the loss" in alone.stderr) == bool(beyond)
    assert alone.exit_code == bool(beyond), alone.output


def classes(text):
    return lambda folder: (folder / "classes.txt").write_text(text)


def without(pattern):
    return lambda folder: [path.unlink() for path in folder.glob(pattern)]


@pytest.mark.parametrize(("spoil", "options", "text"), [
    (lambda folder: None, {"images": "pictures"}, "cannot list the folder .*pictures"),
    (classes("\n"), {}, "classes.txt: is empty"),
    (classes("lane\n\nverge\n"), {}, "classes.txt: line 2 "),
    (classes("lane\nverge\nlane\n"), {}, "classes.txt: line 3 .* line 1"),
    (classes("lane\n"), {}, r"00\.png: class id 1"),
    (without("labels/*"), {}, r"labels: has no file of the frame 00 \(20 of 20"),
    (without("images/[01][1-9]*"), {}, "images: 2 images; expected at least 10"),
])  # fmt: skip
def test_what_cannot_be_trained_on_is_named(mine, spoil, options, text):
    spoil(mine)
    result = train(mine, "--dry-run", **options)
    assert result.exit_code == 1, result.output
    assert re.search(text, result.stderr)


@pytest.mark.parametrize(("further", "options", "text"), [
    ([], {"labels": None, "classes": None}, "images alone teach nothing: give --labels with "),
    ([], {"classes": None}, "give --labels and --classes, or neither"),
    ([], {"labels": None, "depth": "lidar"}, "give --labels and --classes, or neither"),
    (["--depth-scale", "1000"], {}, "--depth-scale is the unit of --depth"),
    (["--focal-length", "50", "--intrinsics", *"1111"], {}, "state the same"),
])  # fmt: skip
def test_options_that_do_not_fit_are_refused(mine, further, options, text):
    result = train(mine, *further, **options)
    assert result.exit_code == 1
    assert text in result.stderr
    assert not (mine / "run").exists()


@pytest.mark.parametrize(("camera", "text"), [
    (["--intrinsics", "70", "70", "96", "27"], "(96, 27) is outside of its image of 64 x 48 px"),
    (["--focal-length", "4.2"], "focal length of 4.2 px is too short"),
])  # fmt: skip
def test_a_camera_of_another_size_is_refused(mine, camera, text):
    result = train(mine, "--dry-run", *camera, depth="lidar")
    assert result.exit_code == 1
    assert text in result.stderr


@pytest.mark.parametrize(("options", "expected"), [
    (["--depth-scale", 1000], "depth_scale = 1000.0"),
    (["--focal-length", 50], "intrinsics = [50.0, 50.0, 31.5, 23.5]"),
    (["--intrinsics", 50, 51, 30, 20], "intrinsics = [50.0, 51.0, 30.0, 20.0]"),
], ids=str)  # fmt: skip
def test_unit_and_camera_are_keys_of_the_recipe_that_a_dry_run_writes(mine, options, expected):
    result = train(mine, "--dry-run", *STEPS, *map(str, options), depth="lidar")
    assert result.exit_code == 0, result.output
    text = (mine / "run/recipe.toml").read_text()
    assert text.count(f"\n{expected}") == 2
    assert "# intrinsics" not in text or "scale" in expected
    assert not (mine / "run/model.pt").exists()


def test_scans_give_the_depth_and_frames_without_labels_are_left_out(mine):
    """The set is a recording, whose options are those of ssdnet-run."""
    grid = np.mgrid[0:48:3, 0:64:3].reshape(2, -1).astype(np.float32)
    points = np.stack([(grid[1] - 32) / 10, (grid[0] - 24) / 10, 0 * grid[0] + 5, 0 * grid[0]], 1)
    (mine / "scans").mkdir()
    for index in range(20):
        points.astype(np.float32).tofile(mine / f"scans/{index:02}.bin")
    eye = [[float(row == column) for column in range(4)] for row in range(4)]
    camera = [[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]
    (mine / "rig.toml").write_text(f"intrinsics = {camera}\nextrinsics = {eye}\n")
    (mine / "labels/05.png").unlink()
    given = {"points": "scans", "calibration": "rig.toml"}
    result = train(mine, "--dry-run", "--set", "data.workers = 0", **given)
    assert result.exit_code == 0, result.output
    text = (mine / "run/recipe.toml").read_text()
    assert 'kind = "recording"' in text
    assert 'points = "../scans"' in text
    assert "frames = [0, 1, 2, 3, 4, 6, 7," in text
    assert "only 6 of 19 frames are kept apart" in result.stderr
    assert re.search(r"depth.* 5(\.0)? m|5\.0", result.stdout), result.stdout
    refused = train(mine, "--dry-run", "--focal-length", "50", **given)
    assert "state them in --calibration" in refused.stderr
    for path in mine.glob("labels/*"):
        path.rename(path.with_stem(f"label-{path.stem}"))
    other = train(mine, "--dry-run", out="other", **given)
    assert "no file is named like one of the 20 frames, such as 00.png" in other.stderr
