"""Readers on small files in exactly the real layouts, and on the real recordings where present."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime.errors import DatasetError
from training.datasets.camvid import CamVid
from training.datasets.kitti_stream import KittiStream
from training.datasets.virtual_kitti import VirtualKitti


@pytest.fixture
def real_data():
    folder = os.environ.get("SSDNET_DATA")
    if not folder:
        pytest.skip("SSDNET_DATA names no folder with recordings")
    return Path(folder)


def write(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


@pytest.fixture
def camvid(tmp_path):
    for name, value in (("b_2", 3), ("a_1", 11)):
        image = np.zeros((12, 16, 3), np.uint8)
        image[..., 2] = 200  # red in OpenCV's BGR
        write(tmp_path / "train" / f"{name}.png", image)
        label = np.full((12, 16), value, np.uint8)
        label[0] = 9
        write(tmp_path / "trainannot" / f"{name}.png", label)
    return tmp_path


def test_camvid_gives_rgb_and_ignores_unlabelled(camvid):
    first, second = (CamVid(camvid)[i] for i in range(2))
    assert first.name == "camvid/a_1"
    assert (first.rgb[0, 0] == (200, 0, 0)).all()
    assert (first.semantic[1:] == 255).all()
    assert (first.semantic[0] == 9).all()
    assert (second.semantic[1:] == 3).all()
    assert not first.depth.any()
    assert not first.sparse_depth.any()


def test_camvid_errors_name_the_file(camvid):
    with pytest.raises(DatasetError, match="test: no such folder"):
        CamVid(camvid, split="test")
    write(camvid / "trainannot" / "a_1.png", np.full((12, 16), 12, np.uint8))
    with pytest.raises(DatasetError, match=r"a_1.png: class id 12"):
        CamVid(camvid)[0]
    write(camvid / "trainannot" / "a_1.png", np.zeros((12, 15), np.uint8))
    with pytest.raises(DatasetError, match="12x15 differs"):
        CamVid(camvid)[0]
    path = camvid / "train" / "b_2.png"
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(DatasetError, match="truncated or damaged"):
        CamVid(camvid)[1]
    (camvid / "trainannot" / "a_1.png").unlink()
    with pytest.raises(DatasetError, match=r"a_1.png: missing"):
        CamVid(camvid)


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "Scene01" / "clone"
    frames = folder / "frames"
    (tmp_path / "Scene01" / "clone").mkdir(parents=True)
    (folder / "colors.txt").write_text("Category r g b\nRoad 100 60 100\nSky 90 200 255\n")
    (folder / "intrinsic.txt").write_text(
        "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n0 0 725.0 726.0 620.5 187.0\n"
        "0 1 1 1 1 1\n1 0 700.0 701.0 600.5 180.0\n"
    )
    for frame in range(2):
        write(frames / f"rgb/Camera_0/rgb_{frame:05d}.jpg", np.full((8, 10, 3), 90, np.uint8))
        depth = np.full((8, 10), 1234 + frame, np.uint16)
        depth[:2] = 65535
        write(frames / f"depth/Camera_0/depth_{frame:05d}.png", depth)
        label = np.full((8, 10, 3), (100, 60, 100), np.uint8)  # BGR of Road
        label[:2] = (255, 200, 90)
        write(frames / f"classSegmentation/Camera_0/classgt_{frame:05d}.png", label)
    return tmp_path


def test_virtual_kitti_reads_centimetres_classes_and_intrinsics(scene):
    source = VirtualKitti(scene)
    sample = source[1]
    assert len(source) == 2
    assert sample.depth[5, 5] == pytest.approx(12.35)
    assert not sample.depth[:2].any()  # sky
    assert (sample.semantic[:2] == 0).all()
    assert (sample.semantic[2:] == 3).all()
    assert sample.intrinsics[0, 0] == 700
    assert sample.intrinsics[1, 2] == 180


def test_virtual_kitti_leaves_unfinished_scenes_alone(scene):
    (scene / "Scene01" / ".fog.partial" / "frames" / "rgb" / "Camera_0").mkdir(parents=True)
    assert len(VirtualKitti(scene)) == 2


def test_virtual_kitti_chooses_scenes_and_variants(scene):
    assert len(VirtualKitti(scene, scenes=["Scene01"], variants=["clone"])) == 2
    with pytest.raises(DatasetError, match="no frames"):
        VirtualKitti(scene, variants=["fog"])


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda f: (f / "colors.txt").write_text("Category r g b\nMoon 1 2 3\n"), "'Moon'"),
        (lambda f: (f / "colors.txt").write_text("Category r g b\nRoad 1 2\n"), "not 'Category"),
        (lambda f: (f / "intrinsic.txt").unlink(), "intrinsic.txt: cannot be read"),
        (lambda f: (f / "intrinsic.txt").write_text("header\n0 0 1\n"), "fx fy cx cy"),
        (
            lambda f: write(
                f / "frames/classSegmentation/Camera_0/classgt_00000.png",
                np.full((8, 10, 3), (7, 8, 9), np.uint8),
            ),
            r"colour \(9, 8, 7\)",
        ),
        (
            lambda f: write(
                f / "frames/depth/Camera_0/depth_00000.png", np.zeros((8, 10), np.uint8)
            ),
            "expected one channel of uint16",
        ),
        (lambda f: (f / "frames/depth/Camera_0/depth_00000.png").unlink(), "cannot read"),
    ],
)
def test_virtual_kitti_errors_name_what_is_wrong(scene, spoil, text):
    spoil(scene / "Scene01" / "clone")
    with pytest.raises(DatasetError, match=text):
        VirtualKitti(scene)[0]


def test_missing_stream_folders(tmp_path):
    with pytest.raises(DatasetError, match="image_02: no such folder"):
        KittiStream(tmp_path)
    (tmp_path / "image_02").mkdir()
    (tmp_path / "velodyne_fov").mkdir()
    with pytest.raises(DatasetError, match="calib"):
        KittiStream(tmp_path)


def test_real_stream_has_lines_labels_and_the_projected_depth(real_data):
    source = KittiStream(real_data / "kitti_stream", first=50, last=51, semantic_weight=0.2)
    sample = source[0]
    assert len(source) == 2
    assert sample.rgb.shape == (375, 1242, 3)
    png = cv2.imread(str(real_data / "kitti_stream/sparse_depth_02/0000000050.png"), -1) / 256
    agree = np.abs(sample.depth - png) < 0.01
    assert agree.mean() > 0.9999
    assert 40 <= sample.scan_line.max() <= 63  # the lines in the camera's view
    assert ((sample.scan_line >= 0) == (sample.depth > 0)).all()
    # A queue of cars on the road, sky above.
    assert (sample.semantic[300:] == 8).mean() > 0.2
    assert (sample.semantic[300:] == 3).mean() > 0.1
    assert (sample.semantic[:100] == 0).any()
    assert not (sample.semantic[300:] == 0).any()
    with pytest.raises(DatasetError, match="none of them"):
        KittiStream(real_data / "kitti_stream", first=600)


def test_real_camvid_split_sizes(real_data):
    assert len(CamVid(real_data / "camvid")) == 367
    validation = CamVid(real_data / "camvid", split="val")
    assert len(validation) == 101
    assert set(np.unique(validation[0].semantic)) <= {*range(11), 255}
