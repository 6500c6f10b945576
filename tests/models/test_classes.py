"""The class tables."""

import itertools

import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab

from models import CAMVID_CLASSES
from models.classes import CITYSCAPES_CLASSES
from runtime.contract.model_file import load_model_file
from runtime.engine.bundled_models import find_model


def test_no_two_classes_of_camvid_look_alike():
    colors = {info.name: rgb2lab(np.array([[info.color]], float) / 255) for info in CAMVID_CLASSES}
    for (one, color), (other, second) in itertools.combinations(colors.items(), 2):
        assert deltaE_ciede2000(color, second).item() > 15, (one, other)


def test_the_bundled_models_have_the_classes_of_camvid():
    for name in ("ssdnet-lite", "ssdnet-nano"):
        assert load_model_file(find_model(name)).contract.classes == CAMVID_CLASSES


def test_the_classes_of_cityscapes_are_those_of_its_scripts():
    """Names and colours of trainId 0 to 18 in labels.py of cityscapesScripts."""
    names = "road sidewalk building wall fence pole traffic_light traffic_sign vegetation terrain"
    names += " sky person rider car truck bus train motorcycle bicycle"
    colors = """128,64,128 244,35,232 70,70,70 102,102,156 190,153,153 153,153,153 250,170,30
        220,220,0 107,142,35 152,251,152 70,130,180 220,20,60 255,0,0 0,0,142 0,0,70 0,60,100
        0,80,100 0,0,230 119,11,32"""
    expected = zip(names.split(), colors.split(), strict=True)
    found = [(info.name.replace(" ", "_"), info.color) for info in CITYSCAPES_CLASSES]
    assert found == [(name, tuple(map(int, color.split(",")))) for name, color in expected]
