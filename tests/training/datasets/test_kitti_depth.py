"""KITTI's depth completion benchmark on small files in its real layouts."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.kitti_depth import DATE, DRIVE, NUMBERS, SIZE, write_drive, write_selection
from layouts.pictures import cut_short, write
from runtime.errors import DatasetError

KittiDepth = partial(open_set, "kitti-depth")


def assert_depth_is_of_both_maps(sample):
    assert sample.sparse_depth.dtype == sample.depth.dtype == np.float32
    assert np.count_nonzero(sample.sparse_depth) == 1
    assert sample.sparse_depth[2, 3] == 10.25
    assert np.count_nonzero(sample.depth) == 2
    assert sample.depth[2, 3] == 1 / 256
    assert sample.depth[4, 7] == 65534 / 256
    assert sample.scan_line is None
    assert (sample.semantic == 255).all()


def test_drives_pair_images_with_both_maps(tmp_path):
    write_drive(tmp_path)
    source = KittiDepth(tmp_path, cameras=(2, 3))
    assert [source[index].name for index in range(len(source))] == [
        f"{DRIVE}/{camera}/{number}" for camera in (2, 3) for number in NUMBERS
    ]
    left, right = source[0], source[3]
    assert_depth_is_of_both_maps(left)
    assert (left.rgb == (100, 20, 40)).all()
    assert (right.rgb == (200, 20, 40)).all()


def test_intrinsics_are_those_of_the_raw_data_where_it_is_there(tmp_path):
    write_drive(tmp_path)
    left, right = (KittiDepth(tmp_path, cameras=(camera,))[0] for camera in (2, 3))
    assert left.intrinsics.tolist() == [[721.5, 0, 609.5], [0, 722.5, 172.8], [0, 0, 1]]
    assert right.intrinsics.tolist() == [[731.5, 0, 619.5], [0, 732.5, 182.8], [0, 0, 1]]
    (tmp_path / "raw" / DATE / "calib_cam_to_cam.txt").unlink()
    assert KittiDepth(tmp_path)[0].intrinsics is None


def test_selection_has_images_and_intrinsics_of_its_own(tmp_path):
    write_selection(tmp_path)
    source = KittiDepth(tmp_path, split="selection")
    first, second = (source[index] for index in range(2))
    assert first.name == f"{DATE}_drive_0002_sync_image_0000000005_image_02"
    assert_depth_is_of_both_maps(first)
    assert (first.rgb == (200, 20, 40)).all()
    assert first.intrinsics.tolist() == [[721.5, 0, 596.5], [0, 722.5, 149.82], [0, 0, 1]]
    assert second.intrinsics[1, 2] == 149.83


MAPS = f"train/{DRIVE}/proj_depth"


@pytest.mark.parametrize(
    ("lost", "text"),
    [
        ("train", "train: no such folder"),
        (f"{MAPS}/groundtruth/image_03", f"{MAPS}/groundtruth/image_03: no such folder"),
        (
            f"{MAPS}/velodyne_raw/image_02/{NUMBERS[1]}.png",
            rf"velodyne_raw/image_02/{NUMBERS[1]}\.png: missing \(1 of 2",
        ),
        (
            f"raw/{DATE}/{DRIVE}/image_02/data/{NUMBERS[0]}.png",
            rf"image_02/data/{NUMBERS[0]}\.png: missing \(1 of 2",
        ),
    ],
)
def test_missing_parts_of_a_drive_are_named(tmp_path, lost, text):
    write_drive(tmp_path)
    (tmp_path / lost).rename(tmp_path / "elsewhere")
    with pytest.raises(DatasetError, match=text):
        KittiDepth(tmp_path, cameras=(2, 3))


@pytest.mark.parametrize(
    ("file", "spoil", "text"),
    [
        (
            f"{MAPS}/velodyne_raw/image_02/{NUMBERS[0]}.png",
            lambda p: write(p, np.zeros(SIZE, np.uint8)),
            "one channel of 16 bits .* got uint8",
        ),
        (
            f"{MAPS}/groundtruth/image_02/{NUMBERS[0]}.png",
            lambda p: write(p, np.zeros((5, 9), np.uint16)),
            "size 5x9 differs from the frame's 5x8",
        ),
        (f"raw/{DATE}/{DRIVE}/image_02/data/{NUMBERS[0]}.png", cut_short, "truncated or damaged"),
    ],
)
def test_damaged_files_are_named(tmp_path, file, spoil, text):
    write_drive(tmp_path)
    spoil(tmp_path / file)
    with pytest.raises(DatasetError, match=f"{file}.*{text}"):
        KittiDepth(tmp_path)[0]


SELECTED = f"{DATE}_drive_0002_sync_{{}}_0000000005_image_02"


@pytest.mark.parametrize(
    ("lost", "text"),
    [
        ("", "val_selection_cropped: no such folder"),
        (f"image/{SELECTED.format('image')}.png", None),
        (
            f"velodyne_raw/{SELECTED.format('velodyne_raw')}.png",
            rf"velodyne_raw/{SELECTED.format('velodyne_raw')}\.png: missing",
        ),
        (
            f"intrinsics/{SELECTED.format('image')}.txt",
            rf"intrinsics/{SELECTED.format('image')}\.txt: missing",
        ),
    ],
)
def test_missing_parts_of_the_selection_are_named(tmp_path, lost, text):
    write_selection(tmp_path)
    (tmp_path / "val_selection_cropped" / lost).rename(tmp_path / "elsewhere")
    if text is None:  # depth maps without an image are no frame
        assert len(KittiDepth(tmp_path, split="selection")) == 1
        return
    with pytest.raises(DatasetError, match=text):
        KittiDepth(tmp_path, split="selection")
