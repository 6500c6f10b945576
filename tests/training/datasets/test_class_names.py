"""The table of class names against spellings of other tables."""

import pytest

from models import CLASS_TABLES
from training.datasets.class_names import relatives

CAMVID = [info.name for info in CLASS_TABLES["camvid"]]
CITYSCAPES = [info.name for info in CLASS_TABLES["cityscapes"]]


@pytest.mark.parametrize(("name", "expected"), [
    ("Road", "road"), ("road;route", "road"), ("sidewalk;pavement", "pavement"),
    ("construction--flat--sidewalk", "pavement"), ("object--traffic-sign--front", "sign"),
    ("TRAFFIC_LIGHT", "sign"), ("marking--general", "road"), ("person;individual", "pedestrian"),
    ("flat", "road pavement"), ("human", "pedestrian bicyclist"), ("vehicle", "car"),
    ("cow", ""), ("void", ""),
])  # fmt: skip
def test_names_of_other_tables_and_categories(name, expected):
    assert relatives(name, CAMVID) == tuple(expected.split())


def test_an_equal_name_comes_before_a_synonym():
    assert relatives("tree", ["vegetation", "tree"]) == ("tree",)
    assert relatives("sign", CITYSCAPES) == ("traffic sign",)
    assert relatives("vehicle", CITYSCAPES)[:2] == ("car", "truck")
