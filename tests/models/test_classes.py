"""The class tables."""

import itertools

import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab

from models import CAMVID_CLASSES


def test_no_two_classes_of_camvid_look_alike():
    colors = {info.name: rgb2lab(np.array([[info.color]], float) / 255) for info in CAMVID_CLASSES}
    for (one, color), (other, second) in itertools.combinations(colors.items(), 2):
        assert deltaE_ciede2000(color, second).item() > 15, (one, other)
