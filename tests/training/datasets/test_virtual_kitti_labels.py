"""Class pictures against a look-up pixel by pixel."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime.errors import DatasetError
from training.datasets.virtual_kitti_labels import ColorTable, read_classes

PALETTE = np.array([[0, 0, 7], [0, 200, 3], [90, 0, 255], [255, 255, 255]], dtype=np.uint8)
IDS = np.array([4, 0, 255, 2], dtype=np.uint8)


def table():
    packed = PALETTE.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.int32)
    return ColorTable(packed, IDS, Path("colors.txt"))


def write(path, rgb):
    cv2.imwrite(str(path), rgb[..., ::-1])


def test_every_pixel_gets_the_class_of_its_colour(tmp_path):
    index = np.random.default_rng(0).choice(4, size=(7, 9), p=[0.7, 0.1, 0.1, 0.1])
    write(tmp_path / "classes.png", PALETTE[index])
    ids = read_classes(tmp_path / "classes.png", table(), (7, 9))
    assert ids.dtype == np.uint8
    assert np.array_equal(ids, IDS[index])


def test_the_first_unlisted_colour_is_named(tmp_path):
    rgb = PALETTE[np.zeros((4, 5), dtype=int)]
    rgb[2, 3], rgb[3, 1] = (1, 2, 3), (9, 9, 9)
    write(tmp_path / "classes.png", rgb)
    with pytest.raises(DatasetError, match=r"colour \(1, 2, 3\) is not in colors\.txt"):
        read_classes(tmp_path / "classes.png", table(), (4, 5))
