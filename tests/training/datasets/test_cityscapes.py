"""Cityscapes on small files in its real layout."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.cityscapes import HEIGHT, STEM, WIDTH, write_frame, write_stereo
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import file_ids

Cityscapes = partial(open_set, "cityscapes")

# Train id of each of the labelIds 0..33.
TRAIN_IDS = [
    *([255] * 7),
    *(0, 1, 255, 255, 2, 3, 4, 255, 255, 255, 5, 255, 6, 7, 8, 9, 10, 11, 12),
    *(13, 14, 15, 255, 255, 16, 17, 18),
]


@pytest.fixture
def cityscapes(tmp_path):
    write_frame(tmp_path)
    write_stereo(tmp_path)
    return tmp_path


@pytest.mark.parametrize("classes", ["cityscapes", "camvid"])
def test_label_ids_in_every_class_table(cityscapes, classes):
    sample = Cityscapes(cityscapes, classes=classes)[0]
    assert sample.semantic.dtype == np.uint8
    known = file_ids("cityscapes", classes, TRAIN_LABELS)
    ids = [known.get(train_id, 255) for train_id in TRAIN_IDS]
    np.testing.assert_array_equal(sample.semantic, np.broadcast_to(ids, (HEIGHT, WIDTH)))
    assert (sample.rgb == (200, 20, 40)).all()
    assert sample.name == "cityscapes/train/aachen_000000_000019"


def test_depth_is_focal_length_times_baseline_over_disparity(cityscapes):
    sample = Cityscapes(cityscapes)[0]
    focal_baseline = 2262.52 * 0.209313
    # Stored 2, 257, 25601 and 65535 are disparities of 1/256, 1, 100 and 255.99 px.
    expected = [0, 0, 256 * focal_baseline, focal_baseline, focal_baseline / 100]
    assert sample.depth.dtype == np.float32
    assert sample.depth[:5, 7] == pytest.approx(expected, rel=1e-6)
    assert sample.depth[5, 7] == pytest.approx(focal_baseline * 256 / 65534, rel=1e-6)
    assert (sample.depth == sample.depth[:, :1]).all()
    assert sample.returns is None
    assert sample.focal_baseline_px_m == pytest.approx(focal_baseline)
    assert sample.intrinsics.tolist() == [
        [2262.52, 0, 1096.98],
        [0, 2265.3017905988554, 513.137],
        [0, 0, 1],
    ]


def test_without_stereo_there_are_classes_alone(tmp_path):
    write_frame(tmp_path)
    sample = Cityscapes(tmp_path, "cityscapes")[0]
    assert not sample.depth.any()
    assert sample.returns is None
    assert sample.intrinsics is None
    assert sample.focal_baseline_px_m is None
    assert (sample.semantic[:, 7] == 0).all()


def test_frames_are_those_of_the_split_in_order_of_cities(tmp_path):
    for stem in ("bochum/bochum_000000_000313", "aachen/aachen_000001_000019", STEM):
        write_frame(tmp_path, stem)
    write_frame(tmp_path, "frankfurt/frankfurt_000000_000294", "val")
    train = Cityscapes(tmp_path)
    assert [train[index].name.split("/")[-1] for index in range(len(train))] == [
        "aachen_000000_000019",
        "aachen_000001_000019",
        "bochum_000000_000313",
    ]
    val = Cityscapes(tmp_path, split="val")
    assert [len(val), val[0].name] == [1, "cityscapes/val/frankfurt_000000_000294"]
