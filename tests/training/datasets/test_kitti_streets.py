"""KITTI's streets on small files in their layout: scan and stereo truth side by side."""

import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from layouts import open_set
from layouts.kitti_streets import HEIGHT, WIDTH, write_streets
from layouts.pictures import write
from runtime.base.errors import DatasetError

KittiStreets = partial(open_set, "kitti-streets")

DATA = Path(os.environ.get("SSDNET_DATA", "")) / "kitti_streets"


@pytest.fixture
def streets(tmp_path):
    write_streets(tmp_path)
    return tmp_path


def test_the_scan_is_the_input_and_the_disparity_the_target(streets):
    sample = KittiStreets(streets)[0]
    assert sample.name == "kitti_streets/000002"
    assert sample.rgb.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(sample.rgb.astype(int) - (200, 20, 40)).max() <= 4  # JPEG
    assert sample.depth.dtype == sample.returns.dtype == np.float32
    assert (sample.depth[:, :8] == 10.0).all()  # 40 px m / 4 px
    assert not sample.depth[:, 8:].any()
    assert {(int(u), int(v)): sample.scan_line[v, u] for v, u in np.argwhere(sample.returns)} == {
        (u, v): line for line, v in enumerate((1, 3, 5, 7)) for u in (2, 6, 12)
    }
    assert sample.returns[1, 12] == pytest.approx(10.0)
    assert ((sample.scan_line >= 0) == (sample.returns > 0)).all()
    assert sample.intrinsics.tolist() == [[10, 0, 8], [0, 10, 4], [0, 0, 1]]
    assert sample.focal_baseline_px_m == 40
    assert (sample.semantic == 255).all()


def test_the_returns_of_the_frame_may_be_the_target_instead(streets):
    accumulated, scan = KittiStreets(streets)[0], KittiStreets(streets, truth="scan")[0]
    assert scan.is_scan
    np.testing.assert_array_equal(scan.depth, accumulated.returns)
    np.testing.assert_array_equal(scan.scan_line, accumulated.scan_line)


def test_the_road_is_a_mask_and_labels_are_read_where_they_are(streets):
    assert KittiStreets(streets)[0].targets.keys() == {"depth"}
    write_streets(streets, road=True)
    (streets / "semantic").mkdir()
    with pytest.raises(DatasetError, match="semantic"):
        KittiStreets(streets)
    label = np.tile(np.arange(WIDTH, dtype=np.uint8) % 12, (HEIGHT, 1))
    write(streets / "semantic" / "000003.png", label)
    source = KittiStreets(streets)
    assert source[0].targets.keys() == {"depth", "road_mask"}
    assert (source[0].targets["road_mask"] == (np.arange(WIDTH) >= WIDTH // 2)).all()
    assert (source[1].semantic == np.where(label == 11, 255, label)).all()
    # A table that they are not mapped to leaves them unread.
    assert KittiStreets(streets, classes="cityscapes")[1].targets.keys() == {"depth", "road_mask"}


@pytest.mark.parametrize(("first", "last", "names"), [
    (0, None, ["2", "3", "7"]), (3, None, ["3", "7"]), (0, 3, ["2", "3"]), (4, 7, ["7"]),
])  # fmt: skip
def test_blocks_are_of_numbers_not_of_places(streets, first, last, names):
    source = KittiStreets(streets, first=first, last=last)
    assert [source[index].name for index in range(len(source))] == [
        f"kitti_streets/00000{name}" for name in names
    ]


def test_validation_frames_show_eight_places(tmp_path):
    numbers = (*range(69, 82), 83, 84, 85, 86, *range(88, 100))
    write_streets(tmp_path, numbers)
    source = KittiStreets(tmp_path)
    places = [source[index].place for index in range(len(source))]
    assert places[0] is places[-1] is None  # 69 and 99
    assert len(set(places[1:-1])) == 8
    counts = [places.count(place) for place in dict.fromkeys(places[1:-1])]
    assert counts == [1, 1, 10, 1, 1, 2, 1, 10]


@pytest.mark.skipif(not DATA.is_dir(), reason="SSDNET_DATA names no folder with kitti_streets")
def test_recorded_streets_agree_with_their_truth():
    training, validation = KittiStreets(DATA, last=81), KittiStreets(DATA, first=83, last=98)
    assert (len(training), len(validation)) == (77, 15)
    for index in (0, 7, 14):
        sample = validation[index]
        assert sample.size == (375, 1242)
        assert sample.scan_line.max() == 45  # of the 64 lines, those in the camera's view
        assert 0.03 < np.mean(sample.returns > 0) < 0.05
        assert 0.1 < np.mean(sample.depth > 0) < 0.3
        both = (sample.returns > 0) & (sample.depth > 0)
        error = np.abs(sample.returns[both] / sample.depth[both] - 1)
        assert np.median(error) < 0.01
