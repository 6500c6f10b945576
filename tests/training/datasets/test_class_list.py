"""Lists of classes, as people and tools write them."""

import numpy as np
import pytest

from layouts.pictures import write
from runtime.base.errors import DatasetError, InputError
from training.datasets.class_list import read_class_list, read_labels
from training.datasets.color_reader import ColorReader
from training.datasets.folders import FoldersRecipe

ROAD, CAR = ("road", (128, 64, 128)), ("car", (0, 0, 142))


def names(*listed):
    return [(name, None) for name in listed]


def read(folder, text):
    path = folder / "classes.txt"
    path.write_text(text, encoding="utf-8")
    return read_class_list(path)


@pytest.mark.parametrize(("text", "classes"), [
    ("traffic light\n2 wheeler\n道路 # a road\n\n", names("traffic light", "2 wheeler", "道路")),
    ("class 0\nclass 1\n", names("class 0", "class 1")),  # no ids: the names would be equal
    ("0 road\n1: car\n", names("road", "car")),
    ("road,0\ncar,1\n", names("road", "car")),
    ("Pixel Value, Class\n0, road\n1, car", names("road", "car")),  # Roboflow
    ('{"10": "k", "0": "a", ' + ", ".join(f'"{i}": "{i}x"' for i in range(1, 10)) + "}",
     names("a", *(f"{i}x" for i in range(1, 10)), "k")),
    ('["road", "car"]', names("road", "car")),
    ('{"car": 1, "road": 0}', names("road", "car")),
    ("road 128 64 128\ncar,0,0,142", [ROAD, CAR]),
    ("name,r,g,b\nroad,128,64,128\ncar,0,0,142", [ROAD, CAR]),
    ("128 64 128\troad\n0 0 142 car", [ROAD, CAR]),
    ("0 road 128 64 128\n1 car 0 0 142", [ROAD, CAR]),
    ("# label:color_rgb:parts:actions\nroad:128,64,128::\ncar:0,0,142:wheel,door:\nbus:::",
     [ROAD, CAR, ("bus", None)]),  # CVAT
])  # fmt: skip
def test_the_forms_of_tools_are_read(tmp_path, text, classes):
    assert [(item.name, item.color) for item in read(tmp_path, text)] == classes


def test_a_class_may_unite_others(tmp_path):
    first, second = read(tmp_path, "drivable 1 2 3 = road, pavement\nrest")
    assert (first.name, first.color, first.relatives) == (
        "drivable",
        (1, 2, 3),
        ("road", "pavement"),
    )
    assert second.relatives == ()


@pytest.mark.parametrize(("text", "message"), [
    ("1 road\n2 car", "line 1 has the id 1; expected 0"),
    ("0 road\n2 car", "line 2 has the id 2; expected 1"),
    ("- road\n- car", "line 1 is not understood"),
    ("names:\n  0: road", "line 1 is not understood"),
    ("road\ncar,tree", "line 2 is not understood"),
    ("item {\n id: 1\n}", "line 1 is not understood"),
    ('{"0": {"name": "road"}}', "entry 1 is no name"),
    ('["road"', "not valid JSON"),
    ("road 300 0 0", "line 1 has the colour 300, 0, 0"),
    ("x =", "line 1 unites a class without a name"),
])  # fmt: skip
def test_what_is_not_understood_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)


COLORS = {"road": (128, 64, 128), "car": (0, 0, 142)}


def labels(folder, *, other=0):
    """A picture of road left and car right in colours; some pixels have other ones."""
    picture = np.zeros((20, 40, 3), np.uint8) + np.array(COLORS["road"], np.uint8)
    picture[:, 20:] = COLORS["car"]
    picture.reshape(-1, 3)[:other] = np.random.default_rng(0).integers(1, 99, (other, 3))
    write(folder / "labels/a.png", picture)
    return folder / "labels"


def open_labels(folder, text, **options):
    path = folder / "classes.txt"
    path.write_text(text)
    classes, keys = read_labels(path, labels(folder), **options)
    reader = FoldersRecipe(path=".", labels="labels", **keys).open_labels(classes)
    return [info.name for info in classes], reader.read(folder / "labels/a.png", (20, 40))


@pytest.mark.parametrize(("text", "options", "names", "ids"), [
    ("road 128 64 128\ncar 0 0 142", {}, ["road", "car"], [0, 1]),
    ("car 0 0 142\nroad 128 64 128", {"ignore": ["Car"]}, ["road"], [0, 255]),
    ("Car\nRoad", {"palette": "cityscapes"}, ["Car", "Road"], [1, 0]),
])  # fmt: skip
def test_labels_in_colours_are_read_by_the_list(tmp_path, text, options, names, ids):
    found, label = open_labels(tmp_path, text, **options)
    assert found == names
    assert label[0, [0, -1]].tolist() == ids
    assert len(np.unique(label)) == 2


@pytest.mark.parametrize(("text", "options", "message"), [
    ("road 128 64 128\ncar", {}, "does not state that of car: write it behind the name"),
    ("road 1 2 3\ncar 1 2 3", {}, "road and car have the colour 1,2,3"),
    ("road\nbus stop", {"palette": "cityscapes"}, "has no colour of bus stop"),
    ("road\nIgnore", {}, "'ignore', which stands for pixels without a class"),
    ("road 128 64 128\nbus 9 9 9", {}, r"1 colours are not .*, 50.00% .*\(0, 0, 142\)"),
])  # fmt: skip
def test_colours_that_are_not_known_are_refused(tmp_path, text, options, message):
    with pytest.raises((InputError, DatasetError), match=message):
        open_labels(tmp_path, text, **options)


def test_mixed_colours_are_those_of_smoothed_edges(tmp_path):
    reader = ColorReader(dict.fromkeys(COLORS.values(), 0), "classes.txt", "")
    with pytest.raises(DatasetError, match=r"100 colours are not .*, 12\.50% .*mixtures"):
        reader.read(labels(tmp_path, other=100) / "a.png", (20, 40))
