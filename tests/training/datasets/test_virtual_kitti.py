"""Both editions of Virtual KITTI on small files in their real layouts, and the paper's split."""

import numpy as np
import pytest

from layouts import open_set
from layouts.virtual_kitti import (
    COLORS,
    HEIGHT,
    RED,
    WIDTH,
    write_first_edition,
    write_second_edition,
)
from runtime.base.errors import DatasetError
from training.datasets.class_mapping import class_ids
from training.datasets.virtual_kitti import PAPER_VARIANTS, VirtualKittiRecipe

# Frames of each scene, the same in all of its ten variants.
LENGTHS = {1: 447, 2: 233, 6: 270, 18: 339, 20: 837}
VARIANTS = (
    *("15-deg-left", "15-deg-right", "30-deg-left", "30-deg-right"),
    *("clone", "fog", "morning", "overcast", "rain", "sunset"),
)


def names(source):
    return [source[index].name for index in range(len(source))]


@pytest.mark.parametrize("edition", [1, 2])
def test_a_frame_is_metres_without_the_sky(tmp_path, edition):
    if edition == 1:
        write_first_edition(tmp_path)
        source = open_set("virtual-kitti-1", tmp_path, split="all")
        intrinsics = [[725, 0, 620.5], [0, 725, 187], [0, 0, 1]]
    else:
        write_second_edition(tmp_path)
        source = open_set("rendered", tmp_path)
        intrinsics = [[726, 0, 620.5], [0, 727, 180], [0, 0, 1]]
    sample = source[1]
    assert sample.name == ("0001" if edition == 1 else "Scene01") + "/clone/00001"
    assert sample.size == (HEIGHT, WIDTH)
    assert np.abs(sample.rgb.astype(int) - RED).max() <= 4  # JPEG
    assert sample.depth.dtype == np.float32
    assert not sample.depth[0].any()
    assert sample.depth[1] == pytest.approx(655.34)
    assert sample.depth[2:] == pytest.approx(12.35)
    assert sample.returns is None
    assert sample.intrinsics.tolist() == intrinsics


@pytest.mark.parametrize("classes", ["virtual_kitti", "camvid", "cityscapes"])
def test_categories_and_instances_are_ids_of_the_class_table(tmp_path, classes):
    ids = [class_ids("virtual_kitti", classes)[name] for name in COLORS]
    write_first_edition(tmp_path / "1")
    write_second_edition(tmp_path / "2")
    second = open_set("rendered", tmp_path / "2", classes)[0].semantic
    np.testing.assert_array_equal(second, np.broadcast_to(ids, (HEIGHT, WIDTH)))
    first = open_set("virtual-kitti-1", tmp_path / "1", classes, split="all")[0].semantic
    *stuff, car, van, _ = ids
    np.testing.assert_array_equal(first, np.broadcast_to([*stuff, car, car, van], (HEIGHT, WIDTH)))


def test_what_is_no_frame_is_left_alone(tmp_path):
    """Scenes still being rendered, and images whose names are no numbers: Scene20 is split."""
    write_second_edition(tmp_path, "Scene20")
    write_first_edition(tmp_path, "0020")
    (tmp_path / "Scene20" / "clone" / "frames" / "rgb" / "Camera_0" / "rgb_mean.jpg").touch()
    (tmp_path / "Scene20" / ".fog.partial" / "frames" / "rgb" / "Camera_0").mkdir(parents=True)
    (tmp_path / ".Scene02").mkdir()
    (tmp_path / "vkitti_1.3.1_rgb" / "0020" / "clone" / "._00000.png").touch()
    for kind in ("virtual-kitti", "virtual-kitti-1"):
        assert len(open_set(kind, tmp_path)) == 2


@pytest.mark.parametrize("scene_name", ["Scene{:02d}", "{:04d}"])
def test_the_papers_split_of_both_editions(scene_name):
    frames = {}
    for split in ("train", "val", "test"):
        recipe = VirtualKittiRecipe(path="vkitti", split=split)
        frames[split] = {
            (scene, variant, number)
            for scene, length in LENGTHS.items()
            for variant in VARIANTS
            if recipe.takes_variant(scene_name.format(scene), variant)
            for number in range(length)
            if recipe.takes(scene_name.format(scene), f"{number:05d}")
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


@pytest.mark.parametrize(("kind", "writer", "scenes"), [
    ("virtual-kitti", write_second_edition, ("Scene01", "Scene02")),
    ("virtual-kitti-1", write_first_edition, ("0001", "0002")),
])  # fmt: skip
def test_readers_take_what_is_selected(tmp_path, kind, writer, scenes):
    for scene in scenes:
        for variant in ("clone", "30-deg-left"):
            writer(tmp_path, scene, variant)

    def chosen(split="all", **words):
        return names(open_set(kind, tmp_path, split=split, **words))

    assert len(chosen()) == 8
    assert chosen("test") == [f"{scenes[0]}/clone/0000{n}" for n in range(2)]
    assert chosen("train") == [f"{scenes[1]}/clone/0000{n}" for n in range(2)]
    assert len(chosen(scenes=(scenes[0],))) == 4
    assert chosen("test", scenes=(scenes[1],), variants=("30-deg-left",)) == [
        f"{scenes[1]}/30-deg-left/0000{n}" for n in range(2)
    ]
    with pytest.raises(DatasetError, match=f"'val'.*those there, {scenes[0]}/30-deg-left"):
        chosen("val")
    with pytest.raises(DatasetError, match="rain"):
        chosen(variants=("rain",))


def test_cameras_are_those_asked_for_and_rendered_frames_are_all_taken(tmp_path):
    write_second_edition(tmp_path, cameras=(0, 1), frames=1)
    write_second_edition(tmp_path, "Scene02", "30-deg-left", frames=1)
    source = open_set("virtual-kitti", tmp_path, cameras=(0, 1), split="test")
    assert names(source) == ["Scene01/clone/00000", "Scene01/clone/00000/1"]
    assert [source[index].intrinsics[1, 2] for index in (0, 1)] == [180, 181]
    # Virtual KITTI's own split knows neither scenes nor variants of rendered ones.
    assert names(open_set("rendered", tmp_path)) == [
        "Scene01/clone/00000",
        "Scene02/30-deg-left/00000",
    ]
