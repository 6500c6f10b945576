"""Both editions of Virtual KITTI on small files in their real layouts, and the paper's split."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.pictures import cut_short, write
from layouts.virtual_kitti import (
    COLORS,
    HEIGHT,
    RED,
    WIDTH,
    depth_picture,
    label_picture,
    write_first_edition,
    write_second_edition,
)
from runtime.errors import DatasetError, InputError
from training.datasets.virtual_kitti import RenderedRecipe
from training.datasets.virtual_kitti_split import PAPER_VARIANTS, Selection
from training.loading.open_dataset import open_dataset
from training.recipe import AnySource, build

VirtualKitti = partial(open_set, "rendered")
VirtualKitti1 = partial(open_set, "virtual-kitti-1", split="all")

#: What the categories of colors.txt are in each class table, in the same order.
IDS = {
    "virtual_kitti": [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 255],
    "camvid": [5, 0, 5, 5, 1, 3, 7, 6, 6, 2, 255, 8, 8, 8, 255],
    "cityscapes": [9, 10, 8, 8, 2, 0, 255, 7, 6, 5, 255, 14, 13, 13, 255],
}
#: Frames of each scene, the same in all of its ten variants.
LENGTHS = {1: 447, 2: 233, 6: 270, 18: 339, 20: 837}
VARIANTS = (
    *("15-deg-left", "15-deg-right", "30-deg-left", "30-deg-right"),
    *("clone", "fog", "morning", "overcast", "rain", "sunset"),
)


@pytest.fixture
def second(tmp_path):
    write_second_edition(tmp_path)
    return tmp_path


@pytest.fixture
def first(tmp_path):
    write_first_edition(tmp_path)
    return tmp_path


def test_second_edition_is_metres_without_the_sky(second):
    source = VirtualKitti(second)
    sample = source[1]
    assert len(source) == 2
    assert sample.name == "Scene01/clone/00001"
    assert sample.size == (HEIGHT, WIDTH)
    assert np.abs(sample.rgb.astype(int) - RED).max() <= 4  # JPEG
    assert sample.depth.dtype == np.float32
    assert not sample.depth[0].any()
    assert sample.depth[1] == pytest.approx(655.34)
    assert sample.depth[2:] == pytest.approx(12.35)
    assert sample.sparse_depth is None
    assert sample.intrinsics.tolist() == [[726, 0, 620.5], [0, 727, 180], [0, 0, 1]]


def test_second_edition_takes_the_cameras_asked_for(tmp_path):
    write_second_edition(tmp_path, cameras=(0, 1), frames=1)
    source = open_set("virtual-kitti", tmp_path, cameras=(0, 1), split="all")
    left, right = source[0], source[1]
    assert (left.name, right.name) == ("Scene01/clone/00000", "Scene01/clone/00000/1")
    assert (left.intrinsics[1, 2], right.intrinsics[1, 2]) == (180, 181)


def test_scenes_still_being_rendered_are_left_alone(second):
    (second / "Scene01" / ".fog.partial" / "frames" / "rgb" / "Camera_0").mkdir(parents=True)
    (second / ".Scene02").mkdir()
    assert len(VirtualKitti(second)) == 2


def test_images_whose_names_are_no_numbers_are_left_alone(tmp_path):
    """Scene20 is split by the number."""
    write_second_edition(tmp_path, "Scene20")
    write_first_edition(tmp_path, "0020")
    (tmp_path / "Scene20" / "clone" / "frames" / "rgb" / "Camera_0" / "rgb_mean.jpg").touch()
    (tmp_path / "vkitti_1.3.1_rgb" / "0020" / "clone" / "._00000.png").touch()
    for kind in ("virtual-kitti", "virtual-kitti-1"):
        assert len(open_set(kind, tmp_path)) == 2


def spoil_label(folder, image):
    write(folder / "frames/classSegmentation/Camera_0/classgt_00000.png", image)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda f: (f / "colors.txt").unlink(), r"cannot read .*colors\.txt"),
        (
            lambda f: (f / "colors.txt").write_text("Category r g b\nMoon 1 2 3\n"),
            r"colors\.txt: unknown category 'Moon'",
        ),
        (
            lambda f: (f / "colors.txt").write_text("Category r g b\nRoad 1 2\n"),
            r"colors\.txt: 'Road 1 2' is not 'Category r g b'",
        ),
        (
            lambda f: (f / "colors.txt").write_text("Category r g b\nRoad 1 2 256\n"),
            r"colors\.txt: 'Road 1 2 256' is not 'Category r g b'",
        ),
        (lambda f: (f / "intrinsic.txt").unlink(), r"cannot read .*intrinsic\.txt"),
        (
            lambda f: (f / "intrinsic.txt").write_text("header\n0 0 1\n"),
            r"intrinsic\.txt: '0 0 1' is not 'frame cameraID fx fy cx cy'",
        ),
        (
            lambda f: (f / "intrinsic.txt").write_text("header\n0 0 0 726 620 187\n"),
            r"intrinsic\.txt: '0 0 0 726 620 187' is not 'frame cameraID fx",
        ),
        (
            lambda f: (f / "intrinsic.txt").write_text("header\n0 0 nan 726 620 187\n"),
            r"intrinsic\.txt: '0 0 nan 726 620 187' is not 'frame cameraID fx",
        ),
        (
            lambda f: (f / "frames/depth/Camera_0/depth_00001.png").unlink(),
            r"depth/Camera_0/depth_00001\.png: missing \(1 of 2",
        ),
        (
            lambda f: (f / "frames/rgb").rename(f / "frames/elsewhere"),
            "clone/frames/rgb/Camera_0: no such",
        ),
    ],
)
def test_second_edition_with_missing_parts_is_not_opened(second, spoil, text):
    spoil(second / "Scene01" / "clone")
    with pytest.raises(DatasetError, match=text):
        VirtualKitti(second)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (
            lambda f: spoil_label(f, np.full((HEIGHT, WIDTH, 3), (9, 8, 7), np.uint8)),
            r"classgt_00000\.png: colour \(9, 8, 7\) is not in colors\.txt",
        ),
        (
            lambda f: spoil_label(f, label_picture(COLORS.values())[:-1]),
            r"classgt_00000\.png: its size 7x15 differs from the frame's 8x15",
        ),
        (
            lambda f: write(
                f / "frames/depth/Camera_0/depth_00000.png", depth_picture(0)[:, :-1].copy()
            ),
            r"depth_00000\.png: its size 8x14 differs from the frame's 8x15",
        ),
        (
            lambda f: cut_short(f / "frames/rgb/Camera_0/rgb_00000.jpg"),
            r"rgb_00000\.jpg is empty, truncated or damaged",
        ),
    ],
)
def test_second_edition_names_the_damaged_file(second, spoil, text):
    spoil(second / "Scene01" / "clone")
    source = VirtualKitti(second)
    assert source[1].depth.any()
    with pytest.raises(DatasetError, match=text):
        source[0]


def test_first_edition_is_metres_without_the_sky(first):
    source = VirtualKitti1(first)
    sample = source[1]
    assert len(source) == 2
    assert sample.name == "0001/clone/00001"
    assert (sample.rgb == RED).all()
    assert not sample.depth[0].any()
    assert sample.depth[1] == pytest.approx(655.34)
    assert sample.depth[2:] == pytest.approx(12.35)
    assert sample.sparse_depth is None
    assert sample.intrinsics.tolist() == [[725, 0, 620.5], [0, 725, 187], [0, 0, 1]]


@pytest.mark.parametrize("classes", list(IDS))
def test_first_edition_maps_instances_by_their_category(first, classes):
    semantic = VirtualKitti1(first, classes=classes)[0].semantic
    *stuff, car, van, _ = IDS[classes]
    expected = [*stuff, car, car, van]
    np.testing.assert_array_equal(semantic, np.broadcast_to(expected, (HEIGHT, WIDTH)))


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (
            lambda f: (f / "vkitti_1.3.1_rgb").rename(f / "elsewhere"),
            r"vkitti_1\.3\.1_rgb: no such folder",
        ),
        (
            lambda f: (f / "vkitti_1.3.1_depthgt/0001/clone/00001.png").unlink(),
            r"vkitti_1\.3\.1_depthgt/0001/clone/00001\.png: missing",
        ),
        (
            lambda f: (f / "vkitti_1.3.1_scenegt/0001_clone_scenegt_rgb_encoding.txt").unlink(),
            r"cannot read .*0001_clone_scenegt_rgb_encoding\.txt",
        ),
        (
            lambda f: (f / "vkitti_1.3.1_scenegt/0001_clone_scenegt_rgb_encoding.txt").write_text(
                "Category(:id) r g b\nMoon:Moon0 1 2 3\n"
            ),
            r"0001_clone_scenegt_rgb_encoding\.txt: unknown category 'Moon'",
        ),
    ],
)
def test_first_edition_with_missing_parts_is_not_opened(first, spoil, text):
    spoil(first)
    with pytest.raises(DatasetError, match=text):
        VirtualKitti1(first)


@pytest.mark.parametrize("scene_name", ["Scene{:02d}", "{:04d}"])
def test_the_papers_split_of_both_editions(scene_name):
    frames = {}
    for split in ("train", "val", "test"):
        selection = Selection(split)
        frames[split] = {
            (scene, variant, number)
            for scene, length in LENGTHS.items()
            for variant in VARIANTS
            if selection.takes_variant(scene_name.format(scene), variant)
            for number in range(length)
            if selection.takes(scene_name.format(scene), f"{number:05d}")
        }
    assert {split: len(taken) for split, taken in frames.items()} == {
        "train": 11112,
        "val": 2320,
        "test": 3576,
    }
    assert len(set.union(*frames.values())) == 11112 + 2320 + 3576  # none is in two of them
    assert len(PAPER_VARIANTS) == 8
    assert {variant for _, variant, _ in set.union(*frames.values())} == set(PAPER_VARIANTS)
    assert {scene for scene, _, _ in frames["test"]} == {1}
    assert {(scene, number) for scene, _, number in frames["val"]} == {
        (20, number) for number in range(547, 837)
    }


@pytest.mark.parametrize(
    ("kind", "writer", "scenes"),
    [
        ("virtual-kitti", write_second_edition, ("Scene01", "Scene02")),
        ("virtual-kitti-1", write_first_edition, ("0001", "0002")),
    ],
)
def test_readers_take_what_is_selected(tmp_path, kind, writer, scenes):
    for scene in scenes:
        for variant in ("clone", "30-deg-left"):
            writer(tmp_path, scene, variant)

    def names(split="all", **words):
        source = open_set(kind, tmp_path, split=split, **words)
        return [source[index].name for index in range(len(source))]

    assert len(names()) == 8
    assert names(split="test") == [f"{scenes[0]}/clone/0000{n}" for n in range(2)]
    assert names(split="train") == [f"{scenes[1]}/clone/0000{n}" for n in range(2)]
    assert len(names(scenes=(scenes[0],))) == 4
    assert names(scenes=(scenes[0],), variants=("30-deg-left",)) == [
        f"{scenes[0]}/30-deg-left/0000{n}" for n in range(2)
    ]
    with pytest.raises(DatasetError, match=r"no frames of the split 'val'"):
        names(split="val")
    with pytest.raises(DatasetError, match=r"variants: rain\. Found: .*clone"):
        names(variants=("rain",))


def test_recipes_choose_edition_split_and_list(tmp_path):
    write_second_edition(tmp_path / "vkitti2", "Scene01", "clone", cameras=(0, 1))
    write_second_edition(tmp_path / "vkitti2", "Scene02", "30-deg-left")
    write_first_edition(tmp_path / "vkitti1", "0002", "fog")

    def names(kind, path, classes="camvid", **keys):
        source = open_dataset(
            build(AnySource, {"kind": kind, "path": path, **keys}), [tmp_path], classes=classes
        )
        return [source[index].name for index in range(len(source))]

    test = ["Scene01/clone/00000", "Scene01/clone/00001"]
    assert names("virtual-kitti", "vkitti2", split="test") == test
    assert names("virtual-kitti", "vkitti2", split="test", cameras=[1]) == [f"{n}/1" for n in test]
    # Virtual KITTI's own split knows neither scenes nor variants of rendered ones: all are taken.
    assert len(names("rendered", "vkitti2")) == 4
    assert names("virtual-kitti-1", "vkitti1", classes="virtual_kitti") == [
        "0002/fog/00000",
        "0002/fog/00001",
    ]
    small = RenderedRecipe(path="vkitti2", size=(32, 48))
    assert open_dataset(small, [tmp_path / "nowhere", tmp_path], classes="camvid")[0].size == (
        32,
        48,
    )
    with pytest.raises(DatasetError, match=rf"no folder 'vkitti3' \(rendered\) in '{tmp_path}'"):
        names("rendered", "vkitti3")
    with pytest.raises(
        InputError, match="split = 'trainval': Input should be 'train', 'val', 'test' or"
    ):
        names("virtual-kitti", "vkitti2", split="trainval")
