"""KITTI streams on small files in their real layout, and on the recording if it is there."""

import os
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from layouts import open_set
from layouts.kitti_stream import write_objects, write_stream
from runtime.base.errors import DatasetError

KittiStream = partial(open_set, "kitti-stream")


DATA = Path(os.environ.get("SSDNET_DATA", "nowhere"))
recorded = pytest.mark.skipif(not DATA.is_dir(), reason="SSDNET_DATA names no recordings")


@pytest.fixture
def stream(tmp_path):
    write_stream(tmp_path)
    return tmp_path


def test_stream_keeps_lines_apart_and_the_nearest_return(stream):
    sample = KittiStream(stream, semantic_weight=0.2)[0]
    assert {(v, u): sample.depth[v, u] for v, u in np.argwhere(sample.depth)} == {
        (1, 4): 10.0,
        (1, 12): 5.0,
        (6, 4): 5.0,
    }
    assert sample.scan_line[[1, 1, 6], [4, 12, 4]].tolist() == [0, 1, 1]
    assert np.count_nonzero(sample.scan_line >= 0) == 3
    assert sample.intrinsics.tolist() == [[10, 0, 8], [0, 10, 4], [0, 0, 1]]
    assert sample.weights == {"semantic": 0.2}


@pytest.mark.parametrize(("classes", "ids"), [
    ("camvid", [3, 4, 1, 1, 7, 2, 6, 6, 5, 5, 0, 9, 10, 8, 8, 8]), ("cityscapes", list(range(16))),
])  # fmt: skip
def test_stream_labels_are_train_ids(stream, classes, ids):
    source = KittiStream(stream, classes=classes)
    assert (source[0].semantic[0] == 255).all()
    assert (source[0].semantic[1:] == ids).all()
    assert (source[1].semantic == 255).all()


def test_stream_takes_its_first_to_last_frame(stream):
    source = KittiStream(stream, first=1, last=1)
    assert [len(source), source[0].name] == [1, "kitti_stream/0000000001"]
    with pytest.raises(DatasetError, match=r"image_02: 3 images.* 3\.\."):
        KittiStream(stream, first=3)


def test_object_data_has_a_calibration_a_frame_and_some_scans(tmp_path):
    write_objects(tmp_path)
    source = KittiStream(tmp_path, semantic_weight=0.5)
    scanned, alone = source[0], source[1]
    assert [len(source), scanned.name, alone.name] == [
        2,
        "kitti_object/000004",
        "kitti_object/000008",
    ]
    assert {(v, u): scanned.depth[v, u] for v, u in np.argwhere(scanned.depth)} == {
        (1, 4): 10.0,
        (1, 12): 5.0,
        (6, 4): 5.0,
    }
    assert scanned.scan_line[6, 4] == 1
    assert (scanned.semantic == 8).all()  # trucks
    assert not alone.depth.any()
    assert alone.scan_line is None
    assert [scanned.focal_length_px, alone.focal_length_px] == [10, 20]
    (tmp_path / "calib" / "000008.txt").unlink()
    with pytest.raises(DatasetError, match=r"000008\.txt"):
        source[1]


@recorded
def test_real_stream_has_lines_labels_and_the_projected_depth():
    source = KittiStream(DATA / "kitti_stream", first=50, last=51, semantic_weight=0.2)
    sample = source[0]
    assert len(source) == 2
    assert sample.rgb.shape == (375, 1242, 3)
    png = cv2.imread(str(DATA / "kitti_stream/sparse_depth_02/0000000050.png"), -1) / 256
    # The maps were made with floor instead of rint: the same returns, half a pixel beside.
    assert np.count_nonzero(sample.depth) == pytest.approx(np.count_nonzero(png), rel=0.01)
    assert np.median(sample.depth[sample.depth > 0]) == pytest.approx(
        np.median(png[png > 0]), rel=0.01
    )
    assert 40 <= sample.scan_line.max() <= 63  # the lines in the camera's view
    assert ((sample.scan_line >= 0) == (sample.depth > 0)).all()
