"""Training's images go through the engine's reader, and its limits."""

import cv2
import numpy as np
import pytest

import runtime.io.images
from runtime.errors import DatasetError
from training.datasets.files import read_gray, read_rgb


def test_what_is_too_large_is_an_error_that_names_the_file(tmp_path, monkeypatch):
    colour, gray = tmp_path / "colour.png", tmp_path / "gray.png"
    cv2.imwrite(str(colour), np.zeros((40, 50, 3), np.uint8))
    cv2.imwrite(str(gray), np.zeros((40, 50), np.uint16))
    assert read_rgb(colour).shape == (40, 50, 3)
    assert read_gray(gray, np.uint16, (40, 50)).shape == (40, 50)
    monkeypatch.setattr(runtime.io.images, "MAX_PIXELS", 1999)
    with pytest.raises(DatasetError, match=r"colour\.png has 40 x 50 pixels"):
        read_rgb(colour)
    with pytest.raises(DatasetError, match=r"gray\.png has 40 x 50 pixels"):
        read_gray(gray, np.uint16, (40, 50))
