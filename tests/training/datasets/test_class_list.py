"""Lists of classes, as people and tools write them."""

import pytest

from runtime.base.errors import InputError
from training.datasets.class_list import read_class_list

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
