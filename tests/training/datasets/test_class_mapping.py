"""Labels of every data set in every class table, against ids written down by hand."""

import pytest

from models import CLASS_TABLES
from runtime.base.errors import DatasetError
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import class_ids, id_lookup


def test_a_set_in_its_own_table_keeps_its_ids():
    for name in ("camvid", "cityscapes"):
        assert list(class_ids(name, name).values()) == list(range(len(CLASS_TABLES[name])))
    assert list(class_ids("virtual_kitti", "virtual_kitti").values())[:14] == list(range(14))


def test_cityscapes_in_camvids_classes():
    lookup = id_lookup("cityscapes", "camvid", TRAIN_LABELS)
    # By trainId: road, sidewalk, building, wall, fence, pole, light, sign, vegetation, terrain,
    # sky, person, rider, car, truck, bus, train, motorcycle, bicycle.
    assert lookup[:19].tolist() == [
        *(3, 4, 1, 1, 7, 2, 6, 6, 5, 5),
        *(0, 9, 10, 8, 8, 8, 8, 10, 10),
    ]
    assert (lookup[19:] == 255).all()


def test_rendered_scenes_in_every_table():
    names = [
        *("Sky", "Terrain", "Tree", "Vegetation", "Building", "Road", "GuardRail", "TrafficSign"),
        *("TrafficLight", "Pole", "Misc", "Truck", "Car", "Van"),
        *("Pavement", "Fence", "Pedestrian", "Cyclist"),  # which are added
    ]
    expected = {
        "virtual_kitti": [1, 0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 255, 255, 255, 255],
        "camvid": [0, 5, 5, 5, 1, 3, 7, 6, 6, 2, 255, 8, 8, 8, 4, 7, 9, 10],
        "cityscapes": [10, 9, 8, 8, 2, 0, 255, 7, 6, 5, 255, 14, 13, 13, 1, 4, 11, 255],
    }
    for table, ids in expected.items():
        assert id_lookup("virtual_kitti", table, names)[:18].tolist() == ids


@pytest.mark.parametrize(("labels", "table"), [
    ("camvid", "cityscapes"), ("cityscapes", "virtual_kitti"), ("virtual_kitti", "ade20k"),
])  # fmt: skip
def test_a_pair_that_mixes_up_classes_is_refused(labels, table):
    with pytest.raises(DatasetError, match=rf"{labels} .*'{table}'.*camvid"):
        class_ids(labels, table)
    with pytest.raises(DatasetError, match=labels):
        class_ids(labels, CLASS_TABLES["camvid"])
