"""Each kind of data set goes to a worker process and names what is wrong."""

import json
import pickle
import re

import numpy as np
import pytest

from layouts import (
    camvid,
    cityscapes,
    kitti_depth,
    kitti_stream,
    kitti_streets,
    open_set,
    virtual_kitti,
)
from layouts.pictures import cut_short, write
from runtime.base.errors import DatasetError
from training.base.tables import build
from training.datasets.registry import DATASETS, AnySource
from training.loading.open_dataset import open_dataset


def write_rendered(root):
    virtual_kitti.write_scans(virtual_kitti.write_second_edition(root, "Scene02"))


def write_cityscapes(root):
    cityscapes.write_frame(root)
    cityscapes.write_stereo(root)


def write_folders(root):
    write(root / "images" / "a.png", np.zeros((12, 16, 3), np.uint8))
    write(root / "depth" / "a.png", np.zeros((12, 16), np.uint16))
    write(root / "labels" / "a.png", np.zeros((12, 16), np.uint8))


# Kind -> what writes a small folder of it, and keys.
LAYOUTS = {
    "camvid": (
        lambda root: camvid.write_frame(
            root, np.zeros((12, 16, 3), np.uint8), np.zeros((12, 16), np.uint8)
        ),
        {},
    ),
    "cityscapes": (write_cityscapes, {}),
    "folders": (write_folders, {"depth": "depth", "labels": "labels"}),
    "kitti-depth": (kitti_depth.write_drive, {}),
    "kitti-stream": (kitti_stream.write_stream, {}),
    "kitti-streets": (lambda root: kitti_streets.write_streets(root, road=True), {}),
    "recording": (write_folders, {"labels": "labels"}),
    "rendered": (write_rendered, {"scans": True}),
    "virtual-kitti": (lambda root: virtual_kitti.write_second_edition(root, "Scene02"), {}),
    "virtual-kitti-1": (lambda root: virtual_kitti.write_first_edition(root, "0002"), {}),
}


@pytest.mark.parametrize("kind", DATASETS)
def test_every_kind_goes_to_a_worker_process_even_after_it_was_read(kind, tmp_path):
    write_kind, keys = LAYOUTS[kind]
    write_kind(tmp_path / kind)
    options = {"kind": kind, "path": kind, "size": [32, 64], **keys}
    source = open_dataset(build(AnySource, options), [tmp_path], classes="camvid")
    expected = source[0]  # what reading leaves behind must not stand in the way
    sample = pickle.loads(pickle.dumps(source))[0]
    assert sample.name == expected.name
    np.testing.assert_array_equal(sample.rgb, expected.rgb)
    np.testing.assert_array_equal(sample.depth, expected.depth)
    assert len(pickle.dumps(source)) < 20_000  # no decoded frames
    assert len(source) == len(source.images)  # which tell whether sets share frames


# In place of a file's content: the file is cut short.
CUT = object()
BAD_DEPTH = np.zeros((8, 14), np.uint16)
DRIVE = f"{kitti_depth.DATE}/{kitti_depth.DRIVE}"
MAPS = f"train/{kitti_depth.DRIVE}/proj_depth"
STEM = cityscapes.STEM
VARIANT = "Scene02/clone"
ENCODING = "vkitti_1.3.1_scenegt/0002_clone_scenegt_rgb_encoding.txt"


def spoil(path, content):
    if content is None:
        path.rename(path.with_name("elsewhere"))
    elif content is CUT:
        cut_short(path)
    elif isinstance(content, str):
        path.write_text(content)
    else:
        write(path, content)


@pytest.mark.parametrize(("kind", "file", "content"), [
    ("camvid", "train", None), ("camvid", "trainannot/a_1.png", None),
    ("cityscapes", "leftImg8bit/train", None),
    ("cityscapes", f"gtFine/train/{STEM}_gtFine_labelIds.png", None),
    ("cityscapes", f"disparity/train/{STEM}_disparity.png", None),
    ("cityscapes", f"camera/train/{STEM}_camera.json", None), ("folders", "images", None),
    ("folders", "labels", None), ("kitti-depth", "train", None),
    ("kitti-depth", f"{MAPS}/groundtruth/image_02", None),
    ("kitti-depth", f"{MAPS}/velodyne_raw/image_02/0000000006.png", None),
    ("kitti-depth", f"raw/{DRIVE}/image_02/data/0000000005.png", None),
    ("kitti-stream", "image_02", None), ("kitti-stream", "velodyne_fov", None),
    ("kitti-stream", "velodyne_fov/0000000000.bin", None),
    ("kitti-stream", "calib_cam_to_cam.txt", None),
    ("kitti-stream", "calib_cam_to_cam.txt", "S_rect_02: 16 8\n"),
    ("kitti-streets", "image_02", None), ("kitti-streets", "disp_occ_0/000003.png", None),
    ("kitti-streets", "road_mask/000003.png", None),
    ("kitti-streets", "velodyne_fov/000007.bin", None), ("kitti-streets", "calib.txt", None),
    *(
        ("kitti-streets", "calib.txt", kitti_streets.CALIBRATION.replace("disp: 40", wrong))
        for wrong in ("nothing: 1", "disp: 0", "disp: nan")
    ),
    ("rendered", f"{VARIANT}/calib.txt", None),
    ("rendered", f"{VARIANT}/frames/lidar/Camera_0/lidar_00001.bin", None),
    ("virtual-kitti", f"{VARIANT}/colors.txt", None),
    ("virtual-kitti", f"{VARIANT}/colors.txt", "Category r g b\nMoon 1 2 3\n"),
    ("virtual-kitti", f"{VARIANT}/colors.txt", "Category r g b\nRoad 1 2\n"),
    ("virtual-kitti", f"{VARIANT}/colors.txt", "Category r g b\nRoad 1 2 256\n"),
    ("virtual-kitti", f"{VARIANT}/colors.txt", "Category r g b\n"),
    ("virtual-kitti", f"{VARIANT}/intrinsic.txt", None),
    ("virtual-kitti", f"{VARIANT}/intrinsic.txt", "header\n0 0 1\n"),
    ("virtual-kitti", f"{VARIANT}/intrinsic.txt", "header\n0 0 0 726 620 187\n"),
    ("virtual-kitti", f"{VARIANT}/intrinsic.txt", "header\n0 0 726 726 nan 187\n"),
    ("virtual-kitti", f"{VARIANT}/intrinsic.txt", "header\n0 0 726 726 620 187\n"),
    ("virtual-kitti", f"{VARIANT}/frames/depth/Camera_0/depth_00001.png", None),
    ("virtual-kitti", f"{VARIANT}/frames/rgb/Camera_0", None),
    ("virtual-kitti-1", "vkitti_1.3.1_rgb", None),
    ("virtual-kitti-1", "vkitti_1.3.1_depthgt/0002/clone/00001.png", None),
    ("virtual-kitti-1", ENCODING, None),
    ("virtual-kitti-1", ENCODING, "Category(:id) r g b\nMoon:Moon0 1 2 3\n"),
])  # fmt: skip
def test_a_set_with_missing_parts_is_not_opened(kind, file, content, tmp_path):
    write_kind, keys = LAYOUTS[kind]
    write_kind(tmp_path)
    open_set(kind, tmp_path, **keys)
    spoil(tmp_path / file, content)
    with pytest.raises(DatasetError, match=re.escape(str(tmp_path / file))):
        open_set(kind, tmp_path, **keys)


@pytest.mark.parametrize(("kind", "file", "content"), [
    ("camvid", "trainannot/a_1.png", np.full((12, 16), 12, np.uint8)),
    ("camvid", "trainannot/a_1.png", np.zeros((12, 15), np.uint8)),
    ("cityscapes", f"leftImg8bit/train/{STEM}_leftImg8bit.png", CUT),
    ("cityscapes", f"gtFine/train/{STEM}_gtFine_labelIds.png", np.full((6, 34), 34, np.uint8)),
    ("cityscapes", f"disparity/train/{STEM}_disparity.png", np.zeros((6, 34), np.uint8)),
    *(
        ("cityscapes", f"camera/train/{STEM}_camera.json", content)
        for content in (
            "{",
            json.dumps({"intrinsic": cityscapes.CAMERA["intrinsic"]}),
            json.dumps(cityscapes.CAMERA | {"intrinsic": {"fx": 1, "fy": 1, "u0": 1}}),
            json.dumps(cityscapes.CAMERA | {"extrinsic": {"baseline": "wide"}}),
            json.dumps(cityscapes.CAMERA | {"extrinsic": {"baseline": 0}}),
        )
    ),
    ("folders", "images/a.png", CUT), ("folders", "labels/a.png", np.full((12, 16), 11, np.uint8)),
    ("folders", "labels/a.png", np.zeros((12, 15), np.uint8)),
    ("folders", "depth/a.png", np.zeros((12, 15), np.uint16)),
    ("folders", "depth/a.png", np.zeros((12, 16), np.uint8)),
    ("kitti-depth", f"{MAPS}/velodyne_raw/image_02/0000000005.png", BAD_DEPTH.astype(np.uint8)),
    ("kitti-depth", f"{MAPS}/groundtruth/image_02/0000000005.png", BAD_DEPTH),
    ("kitti-depth", f"raw/{DRIVE}/image_02/data/0000000005.png", CUT),
    ("kitti-stream", "velodyne_fov/0000000000.bin", "0123"),
    ("kitti-streets", "disp_occ_0/000002.png", np.zeros((8, 17), np.uint16)),
    ("kitti-streets", "disp_occ_0/000002.png", np.zeros((8, 16), np.uint8)),
    ("kitti-streets", "road_mask/000002.png", np.full((8, 16), 5, np.uint8)),
    ("kitti-streets", "road_mask/000002.png", np.zeros((7, 16), np.uint8)),
    ("virtual-kitti", f"{VARIANT}/frames/rgb/Camera_0/rgb_00000.jpg", CUT),
    ("virtual-kitti", f"{VARIANT}/frames/depth/Camera_0/depth_00000.png", BAD_DEPTH),
    *(
        ("virtual-kitti", f"{VARIANT}/frames/classSegmentation/Camera_0/classgt_00000.png", bad)
        for bad in (
            np.full((8, 15, 3), (9, 8, 7), np.uint8),  # of no category
            np.zeros((7, 15, 3), np.uint8),
        )
    ),
])  # fmt: skip
def test_damaged_files_are_named_where_they_are_read(kind, file, content, tmp_path):
    write_kind, keys = LAYOUTS[kind]
    write_kind(tmp_path)
    spoil(tmp_path / file, content)
    source = open_set(kind, tmp_path, **keys)
    with pytest.raises(DatasetError, match=re.escape(str(tmp_path / file))):
        source[0]
