"""Data of one's own: pictures, depth and labels by stem, with a class table in the recipe."""

import os
import re
import struct
import zlib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from layouts.pictures import write
from runtime.contract import ClassInfo
from runtime.errors import DatasetError, InputError
from training.datasets.folders import FoldersRecipe
from training.datasets.source_recipe import SourceRecipe
from training.loop import train
from training.recipe import read_recipe

CLASSES = (ClassInfo("lane", (10, 20, 30)), ClassInfo("rest", (200, 0, 0)))
RECIPE = """
[model]
name = "ssdnet-small"
config.stem_channels = [8, 8]
config.encoder_channels = [8, 8]
config.encoder_blocks = [1, 1]
config.decoder_channels = [8, 8]
classes = [{name = "lane", color = [10, 20, 30]}, {name = "rest", color = [200, 0, 0]}]
[data]
batch_size = 2
workers = 0
augment.crop = [32, 64]
[[data.source]]
kind = "folders"
path = "mine"
depth = "depth"
labels = "labels"
depth_scale = 1000
intrinsics = [50, 50, 32, 16]
[schedule]
steps = 1
"""


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
    recipe = FoldersRecipe(
        path="mine",
        depth="depth",
        sparse_depth="scans",
        labels="labels",
        depth_scale=1000,
        intrinsics=(50, 51, 32, 16),
        semantic_weight=0.5,
    )
    source = recipe.open(mine, CLASSES)
    assert len(source) == 2
    first = source[0]
    assert first.name == "mine/a"
    assert (first.rgb == 81).all()
    assert first.depth.dtype == np.float32
    assert (first.depth[:10] == 0).all()
    assert (first.depth[10:] == 2.5).all()
    assert (first.sparse_depth[10:] == 1.25).all()
    assert np.unique(first.semantic).tolist() == [0, 1, 255]
    assert (first.semantic[:4] == 255).all()
    assert first.intrinsics.tolist() == [[50, 0, 32], [0, 51, 16], [0, 0, 1]]
    assert first.weights == {"semantic": 0.5}


def test_a_part_of_the_images_may_be_taken(mine):
    (mine / "labels" / "b.png").unlink()  # of an image that is not taken
    source = FoldersRecipe(path="mine", labels="labels", last=0).open(mine, CLASSES)
    assert [source[index].name for index in range(len(source))] == ["mine/a"]
    source = FoldersRecipe(path="mine", first=1).open(mine, CLASSES)
    assert [source[index].name for index in range(len(source))] == ["mine/b"]
    with pytest.raises(DatasetError, match=r"images: 2 images, none of them in 2\.\.\. Correct"):
        FoldersRecipe(path="mine", first=2).open(mine, CLASSES)


def test_another_id_may_mean_no_class(mine):
    recipe = FoldersRecipe(path="mine", labels="labels", ignore=0)
    write(mine / "labels" / "a.png", np.repeat(np.uint8([[0, 1]]), 40, 0).repeat(32, 1))
    assert np.unique(recipe.open(mine, CLASSES)[0].semantic).tolist() == [1, 255]


def test_train_ids_of_cityscapes_are_mapped(mine):
    """Trucks and trailers are CamVid's cars; an id that is not mapped stays unknown."""
    write(mine / "labels" / "a.png", np.uint8([[0, 2, 10, 13, 14, 15, 255]]).repeat(40, 0))
    write(mine / "images" / "a.png", np.zeros((40, 7, 3), np.uint8))
    recipe = FoldersRecipe(path="mine", labels="labels", label_classes="cityscapes")
    assert recipe.open(mine, "camvid")[0].semantic[5].tolist() == [3, 1, 0, 8, 8, 8, 255]
    assert recipe.open(mine, "cityscapes")[0].semantic[5].tolist() == [0, 2, 10, 13, 14, 15, 255]
    write(mine / "labels" / "a.png", np.full((40, 7), 19, np.uint8))
    with pytest.raises(DatasetError, match=r"class id 19, expected 0\.\.18 of cityscapes"):
        recipe.open(mine, "camvid")[0]
    with pytest.raises(DatasetError, match="cityscapes are not mapped"):
        recipe.open(mine, CLASSES)


@pytest.mark.skipif("SSDNET_DATA" not in os.environ, reason="SSDNET_DATA names no recordings")
def test_recorded_pictures_with_labels_of_a_network():
    recipe = FoldersRecipe(
        path="nuscenes_boston", rgb="image", labels="pseudo_semantic", label_classes="cityscapes"
    )
    source = recipe.open(Path(os.environ["SSDNET_DATA"]) / recipe.path, "camvid")
    assert len(source) == 199
    counts = np.zeros(256, np.int64)
    for index in range(0, 199, 20):
        sample = source[index]
        assert sample.size == (450, 800)
        assert (sample.semantic[440:] == 255).all()  # the bonnet
        counts += np.bincount(sample.semantic.ravel(), minlength=256)
    shares = counts / counts.sum()
    assert shares[[0, 1, 3, 8]].min() > 0.02  # sky, buildings, road, cars
    assert shares[:11].sum() > 0.6


def test_ids_are_named_by_the_recipe(mine, tmp_path):
    text = RECIPE.replace(
        'labels = "labels"', 'labels = "labels"\nlabel_ids = {7 = "rest", 0 = "lane", 9 = "ignore"}'
    )
    write(mine / "labels" / "a.png", np.uint8([[0, 7, 9, 255]]).repeat(40, 0).repeat(16, 1))
    (tmp_path / "r.toml").write_text(text)
    recipe = read_recipe(tmp_path / "r.toml").data.source[0]
    assert recipe.open(mine, CLASSES)[0].semantic[5, ::16].tolist() == [0, 1, 255, 255]
    with pytest.raises(DatasetError, match=r"class id 1, expected one of label_ids: 7, 0, 9, or"):
        recipe.open(mine, CLASSES)[1]
    with pytest.raises(
        DatasetError, match=r"7 = 'rest' is no class of model\.classes; .* 'ignore'"
    ):
        recipe.open(mine, CLASSES[:1])
    for keys, message in (
        ("label_classes = 'cityscapes', label_ids = {1 = 'lane'}", "label_ids and label_classes"),
        ("label_ids = {300 = 'lane'}", r"label_ids.*300"),
        ("labels = 'l', ignore = 0, label_ids = {0 = 'lane'}", "give the id 0 two meanings"),
    ):
        source = f"data.source = [{{kind = 'folders', path = 'mine', {keys}}}]"
        with pytest.raises(InputError, match=message):
            read_recipe(tmp_path / "r.toml", [source])


@pytest.mark.parametrize(
    ("ids", "keys"), [([1, 2, 3], ""), ([0, 7], 'label_ids = {0 = "lane", 1 = "rest"}')]
)
def test_the_advice_for_unknown_ids_can_be_followed(mine, tmp_path, ids, keys):
    for name in "ab":
        write(mine / "labels" / f"{name}.png", np.uint8([ids * 64])[:, :64].repeat(40, 0))
    (tmp_path / "r.toml").write_text(
        RECIPE.replace('labels = "labels"', f'labels = "labels"\n{keys}')
    )
    with pytest.raises(DatasetError, match=f"class id {ids[-1]}, expected") as refused:
        train(read_recipe(tmp_path / "r.toml"), data=[tmp_path], out=tmp_path / "run")
    (advice,) = re.findall(r"label_ids = {.*}", str(refused.value))
    (tmp_path / "r.toml").write_text(
        RECIPE.replace('labels = "labels"', f'labels = "labels"\n{advice}')
    )
    recipe = read_recipe(tmp_path / "r.toml")
    train(recipe, data=[tmp_path], out=tmp_path / "run")
    unknown = [255 if id_ > 1 else id_ for id_ in ids]
    labels = recipe.data.source[0].open(mine, CLASSES)[0].semantic
    assert labels[0, : len(ids)].tolist() == unknown


def write_png(path, ids, bits, kind):
    """Write ids as gray values (kind 0) or palette indices (3), with no encoder's help."""
    values = np.unpackbits(ids[..., None], axis=2)[..., 8 - bits :]
    rows = np.packbits(values.reshape(len(ids), -1), axis=1)
    pixels = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    header = struct.pack(">2I5B", ids.shape[1], ids.shape[0], bits, kind, 0, 0, 0)
    palette = [(b"PLTE", bytes(range(1, 4)) * 2**bits)] if kind == 3 else []
    content = b"\x89PNG\r\n\x1a\n"
    for name, body in ((b"IHDR", header), *palette, (b"IDAT", pixels), (b"IEND", b"")):
        content += struct.pack(">I", len(body)) + name + body
        content += struct.pack(">I", zlib.crc32(name + body))
    path.write_bytes(content)


@pytest.mark.parametrize("kind", [0, 3], ids=["gray", "palette"])
@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_labels_are_the_ids_that_a_file_stores(mine, bits, kind):
    """A picture decoder gives the ids 0 and 1 of one bit as 0 and 255, and colours of a palette."""
    ids = np.random.default_rng(0).integers(0, 2**bits, (40, 64), dtype=np.uint8)
    classes = tuple(ClassInfo(f"class {number}", (0, 0, 0)) for number in range(255))
    write_png(mine / "labels" / "a.png", ids, bits, kind)
    source = FoldersRecipe(path="mine", labels="labels").open(mine, classes)
    np.testing.assert_array_equal(source[0].semantic, ids)
    content = (mine / "labels" / "a.png").read_bytes()
    (mine / "labels" / "a.png").write_bytes(content[:-24])
    with pytest.raises(DatasetError, match="truncated or damaged"):
        source[0]


def test_frames_without_a_target_may_be_skipped(mine, tmp_path, capsys):
    keys = {"depth": "depth", "sparse_depth": "scans", "labels": "labels", "path": "mine"}
    for folder in ("depth", "scans", "labels"):
        (mine / folder / "b.png").unlink()
        with pytest.raises(DatasetError, match=rf'{folder}: has no file .* b .*"skip-target"'):
            FoldersRecipe(path="mine", **{k: v for k, v in keys.items() if v == folder}).open(
                mine, CLASSES
            )
    recipe = FoldersRecipe(missing="skip-target", **keys)
    first, second = recipe.open(mine, CLASSES)[0], recipe.open(mine, CLASSES)[1]
    said = re.findall(r"(\w+): has no file of the frame b \(1 of 2 frames", capsys.readouterr().err)
    assert said == 2 * ["depth", "scans", "labels"]
    assert first.targets.keys() == {"depth", "semantic"}
    assert first.sparse_depth.any()
    assert not second.targets
    assert not second.sparse_depth.any()
    (tmp_path / "r.toml").write_text(RECIPE)
    run = read_recipe(tmp_path / "r.toml")
    run = replace(run, data=replace(run.data, source=(recipe,)))
    assert train(run, data=[tmp_path], out=tmp_path / "run").name == "model.pt"
    (mine / "labels" / "a.png").unlink()
    with pytest.raises(
        DatasetError, match=r"2 of 2 frames lack it\)\. Add the files, or leave the"
    ):
        recipe.open(mine, CLASSES)


def test_what_is_missing_or_wrong_is_named(mine):
    def opened(**keys):
        return FoldersRecipe(path="mine", **keys).open(mine, CLASSES)

    with pytest.raises(DatasetError, match=r"cannot list the folder .*pictures"):
        opened(rgb="pictures")
    write(mine / "labels" / "a.png", np.full((40, 64), 2, np.uint8))
    with pytest.raises(DatasetError, match=r"a\.png: class id 2, expected 0\.\.1"):
        opened(labels="labels")[0]
    with pytest.raises(DatasetError, match=r"b\.png must be a depth map of one channel"):
        opened(depth="labels")[1]
    write(mine / "depth" / "b.png", np.zeros((40, 63), np.uint16))
    with pytest.raises(DatasetError, match="40x63 differs"):
        opened(depth="depth")[1]
    (mine / "depth" / "b.png").unlink()
    with pytest.raises(DatasetError, match=r"depth: has no file of the frame b \(1 of 2"):
        opened(depth="depth")
    write(mine / "images" / "a.jpg", np.zeros((40, 64, 3), np.uint8))
    with pytest.raises(DatasetError, match="have the same stem"):
        opened()


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[10, 20, 30]", "[10, 20, 300]", r"model\.classes\[0\]\.color\[2\] = 300: "),
        ('"rest"', '"lane"', r"model\.classes has 'lane' twice"),
        ('name = "rest"', 'nam = "rest"', r"unknown key model\.classes\[1\]\.nam; .* name, color"),
        ("depth_scale = 1000", "depth_scale = 0", r"source\[0\]\.depth_scale = 0: "),
    ],
)
def test_mistakes_in_the_recipe_are_named(tmp_path, old, new, text):
    (tmp_path / "r.toml").write_text(RECIPE.replace(old, new))
    with pytest.raises(InputError, match=text):
        read_recipe(tmp_path / "r.toml")


def test_the_docs_name_every_key():
    text = (Path(__file__).parents[3] / "docs" / "training.md").read_text()
    own, common = ({item.name for item in fields(each)} for each in (FoldersRecipe, SourceRecipe))
    assert own - common <= set(re.findall(r"`(\w+)(?: = [^`]+)?`", text))
