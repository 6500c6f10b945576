"""Data of one's own: pictures, depth and labels by stem, with a class table in the recipe."""

import os
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from layouts import open_set
from layouts.pictures import write
from runtime.base.errors import DatasetError, InputError
from runtime.contract.contract import ClassInfo
from training.datasets.folders import FoldersRecipe
from training.datasets.registry import parse_data
from training.datasets.source_recipe import SourceRecipe
from training.recipes.pandaset_street import camera

DATA = Path(os.environ.get("SSDNET_DATA", "nowhere"))

CLASSES = (ClassInfo("lane", (10, 20, 30)), ClassInfo("rest", (200, 0, 0)))


def opened(mine, classes=CLASSES, **keys):
    return open_set("folders", mine, classes, **keys)


@pytest.fixture
def mine(tmp_path):
    for index, name in enumerate(("b.jpg", "a.png")):
        stem = name[0]
        write(tmp_path / "mine" / "images" / name, np.full((40, 64, 3), 80 + index, np.uint8))
        label = np.zeros((40, 64), np.uint8)
        label[:, 30:] = 1
        label[:4] = 255
        write(tmp_path / "mine" / "labels" / f"{stem}.png", label)
        depth = np.full((40, 64), 2500, np.uint16)
        depth[:10] = 0
        write(tmp_path / "mine" / "depth" / f"{stem}.png", depth)
        write(tmp_path / "mine" / "scans" / f"{stem}.png", depth // 2)
    return tmp_path / "mine"


def test_everything_is_paired_by_stem(mine):
    keys = {"depth": "depth", "sparse_depth": "scans", "labels": "labels", "depth_scale": 1000}
    keys |= {"intrinsics": (50, 51, 32, 16), "semantic_weight": 0.5, "lacking": ("rest",)}
    source = opened(mine, **keys)
    assert len(source) == 2
    first = source[0]
    assert first.name == "mine/a"
    assert (first.rgb == 81).all()
    assert first.depth.dtype == np.float32
    assert (first.depth[:10] == 0).all()
    assert (first.depth[10:] == 2.5).all()
    assert (first.returns[10:] == 1.25).all()
    assert (first.semantic[:4] == 255).all()
    assert (first.semantic[4:] == (np.arange(64) >= 30)).all()
    assert first.intrinsics.tolist() == [[50, 0, 32], [0, 51, 16], [0, 0, 1]]
    assert first.weights == {"semantic": 0.5}
    assert first.lacking == (1,)
    assert first.scan_line is None
    with pytest.raises(DatasetError, match=r"lacking: 'sky' is no class .* give one of lane"):
        opened(mine, lacking=("sky",))
    with pytest.raises(DatasetError, match="label_ids: 'car' is no class"):
        opened(mine, labels="labels", label_ids={0: "lane", 7: "car"})
    write(mine / "images" / "a.jpg", np.zeros((40, 64, 3), np.uint8))
    with pytest.raises(DatasetError, match="same stem"):
        opened(mine)


def test_the_depth_may_be_a_scan(mine):
    sample = opened(mine, depth="depth", depth_scale=1000, scan=True)[0]
    assert sample.is_scan
    np.testing.assert_array_equal(sample.scan_line >= 0, sample.depth > 0)
    assert np.unique(sample.scan_line).size > 10


@pytest.mark.parametrize("suffix", [".PNG", ".Png", ".png"])
def test_the_case_of_a_suffix_does_not_matter(mine, suffix, capsys):
    for folder in ("labels", "scans", "depth", "images"):
        for path in (mine / folder).glob("*.png"):
            path.rename(path.with_suffix(suffix))
    sample = opened(mine, depth="depth", sparse_depth="scans", labels="labels")[0]
    assert sample.targets.keys() == {"depth", "semantic"}
    assert sample.returns.any()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("names", "said"), [
    (["images/c.webp", "images/d.WEBP"], "no PNG or JPEG are not read (2 .webp)"),
    (["images/a.tif"], "(1 .tif)"),
    (["labels/x9.png", "labels/x10.png"], "labels: 2 files have no image of their name"),
    (["labels/x9.png", "labels/x10.png"], "are not used, such as x9"),
    (["scans/q.png"], "scans: 1 files have no image"),
    (["depth/q.png"], "depth: 1 files have no image"),
    (["images/night/c.png", "images/day/c.jpg"], "images in day, night are not read"),
    (["images/.c.webp", "labels/.x.png"], ""),
], ids=str)  # fmt: skip
def test_files_that_are_not_used_are_counted(mine, names, said, capsys):
    for name in names:
        write(mine / "x.png", np.zeros((40, 64), np.uint16 if "depth" in name else np.uint8))
        (mine / name).parent.mkdir(exist_ok=True)
        (mine / "x.png").rename(mine / name)
    source = opened(mine, depth="depth", sparse_depth="scans", labels="labels")
    assert len(source) == 2
    err = capsys.readouterr().err
    assert said in err if said else err == ""


@pytest.mark.parametrize(("orientation", "tagged"), [
    (1, ["images", "labels"]), (3, ["images"]), (6, ["images", "labels"]), (8, ["labels"]),
])  # fmt: skip
def test_pixels_are_read_as_stored_and_an_orientation_is_said(
    tmp_path, orientation, tagged, capsys
):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    stored = {
        "images": np.arange(40 * 40 * 3, dtype=np.uint8).reshape(40, 40, 3),
        "labels": (np.arange(1600).reshape(40, 40) % 7 == 0).astype(np.uint8),
        "depth": np.arange(1600, dtype=np.uint16).reshape(40, 40),
    }
    for folder, values in stored.items():
        (tmp_path / folder).mkdir()
        Image.fromarray(values).save(
            tmp_path / folder / "a.png", exif=exif if folder in tagged else Image.Exif()
        )
    sample = opened(tmp_path, labels="labels", depth="depth", depth_scale=1)[0]
    np.testing.assert_array_equal(sample.rgb, stored["images"])
    np.testing.assert_array_equal(sample.semantic, stored["labels"])
    np.testing.assert_array_equal(sample.depth, stored["depth"])
    assert (f"EXIF orientation {orientation}" in capsys.readouterr().err) == (orientation > 1)


def test_folders_beside_that_of_the_images_are_data_too():
    beside = FoldersRecipe(path="images", rgb=".", labels="../labels", depth="depth")
    assert beside.folders == ("images", "labels")


def test_a_part_of_the_images_may_be_taken(mine):
    (mine / "labels" / "b.png").unlink()  # of an image that is not taken
    for keys, name in (({"labels": "labels", "last": 0}, "mine/a"), ({"first": 1}, "mine/b")):
        source = opened(mine, **keys)
        assert [source[index].name for index in range(len(source))] == [name]
    with pytest.raises(DatasetError, match=r"images: 2 images.* 2\.\."):
        opened(mine, first=2)


@pytest.mark.parametrize(("keys", "ids"), [
    ({}, [0, 1, 255]), ({"ignore": 0}, [255, 1, None]),
    ({"label_ids": {7: "rest", 0: "lane", 9: "ignore"}}, [0, None, 255, 1, 255]),
    ({"ignore": 1, "label_ids": {0: "rest"}}, [1, 255, None]),
])  # fmt: skip
def test_ids_have_the_meaning_that_the_keys_give_them(mine, keys, ids):
    """The labels have the ids 0, 1, 255, 7 and 9; None: they are refused, with usable advice."""
    stored = [0, 1, 255, 7, 9][: len(ids)]
    for id_, expected in zip(stored, ids, strict=True):
        write(mine / "labels" / "a.png", np.full((40, 64), id_, np.uint8))
        source = opened(mine, labels="labels", **keys)
        if expected is not None:
            assert (source[0].semantic == expected).all(), id_
            continue
        with pytest.raises(DatasetError, match=rf"a\.png: class id {id_}, ") as refused:
            source[0]
        (advice,) = re.findall(r"label_ids = ({.*})", str(refused.value))
        advised = parse_data(f"folders:{mine},labels=labels,label_ids={advice}")
        assert (advised.open(mine, CLASSES)[0].semantic == (1 if id_ == 1 else 255)).all()


@pytest.mark.parametrize("keys", [
    {"label_classes": "cityscapes", "label_ids": {1: "lane"}}, {"label_ids": {300: "lane"}},
    {"labels": "l", "ignore": 0, "label_ids": {0: "lane"}}, {"scan": True, "sparse_depth": "scans"},
    {"depth_scale": 0},
])  # fmt: skip
def test_keys_that_contradict_each_other_are_refused(mine, keys):
    with pytest.raises(InputError, match="|".join(keys)):
        opened(mine, **keys)


def test_train_ids_of_cityscapes_are_mapped(mine):
    """Trucks and trailers are CamVid's cars; an id that is not mapped stays unknown."""
    write(mine / "labels" / "a.png", np.uint8([[0, 2, 10, 13, 14, 15, 255]]).repeat(40, 0))
    write(mine / "images" / "a.png", np.zeros((40, 7, 3), np.uint8))
    keys = {"labels": "labels", "label_classes": "cityscapes"}
    assert opened(mine, "camvid", **keys)[0].semantic[5].tolist() == [3, 1, 0, 8, 8, 8, 255]
    assert opened(mine, "cityscapes", **keys)[0].semantic[5].tolist() == [0, 2, 10, 13, 14, 15, 255]
    write(mine / "labels" / "a.png", np.full((40, 7), 19, np.uint8))
    with pytest.raises(DatasetError, match=r"class id 19, .*trainIds"):
        opened(mine, "camvid", **keys)[0]
    with pytest.raises(DatasetError, match="cityscapes"):
        opened(mine, **keys)


def test_frames_without_a_target_may_be_skipped(mine, capsys):
    keys = {"depth": "depth", "sparse_depth": "scans", "labels": "labels"}
    for folder in keys.values():
        (mine / folder / "b.png").unlink()
    for key, folder in keys.items():
        with pytest.raises(DatasetError, match=f'{folder}: .* b .*"skip-target"'):
            opened(mine, **{key: folder})
    source = opened(mine, missing="skip-target", **keys)
    said = re.findall(r"(\w+): has no file of the frame b \(1 of 2", capsys.readouterr().err)
    assert said == ["depth", "scans", "labels"]
    first, second = source[0], source[1]
    assert first.targets.keys() == {"depth", "semantic"}
    assert first.returns.any()
    assert not second.targets
    assert not second.returns.any()
    (mine / "labels" / "a.png").unlink()
    with pytest.raises(DatasetError, match="2 of 2"):
        opened(mine, missing="skip-target", **keys)


def test_the_docs_name_every_key():
    text = (Path(__file__).parents[3] / "docs" / "training.md").read_text()
    own, common = ({item.name for item in fields(each)} for each in (FoldersRecipe, SourceRecipe))
    assert own - common <= set(re.findall(r"`(\w+)(?: = [^`]+)?`", text))


@pytest.mark.skipif(not DATA.is_dir(), reason="SSDNET_DATA names no recordings")
def test_a_street_whose_returns_have_classes():
    recipe = camera("right", semantic_weight=5.0)
    sample = recipe.open(DATA / recipe.path, "camvid")[0]
    assert sample.is_scan
    assert 0.05 < (sample.returns > 0).mean() < 0.1
    classes = set(np.unique(sample.semantic[sample.semantic < 255]).tolist())
    assert {1, 3, 8} <= classes
    assert not classes & set(sample.lacking)
    assert sample.focal_length_px == pytest.approx(384.4, abs=0.1)
