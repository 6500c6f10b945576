"""Labels of every data set in every class table, against ids written down by hand."""

import dataclasses

import pytest

from models import CAMVID_CLASSES, CLASS_TABLES
from models.classes import numbered_classes
from models.training_facts import TrainingFacts
from runtime import Predictor
from runtime.base.errors import DatasetError
from training.datasets.cityscapes import TRAIN_LABELS
from training.datasets.class_mapping import class_ids, file_ids, trained_classes


def test_a_set_in_its_own_table_keeps_its_ids():
    for name in ("camvid", "cityscapes"):
        assert list(class_ids(name, name).values()) == list(range(len(CLASS_TABLES[name])))
    assert list(class_ids("virtual_kitti", "virtual_kitti").values())[:14] == list(range(14))


def test_cityscapes_in_camvids_classes():
    ids = file_ids("cityscapes", "camvid", TRAIN_LABELS)
    # By trainId: road, sidewalk, building, wall, fence, pole, light, sign, vegetation, terrain,
    # sky, person, rider, car, truck, bus, train, motorcycle, bicycle.
    assert list(ids.values()) == [*(3, 4, 1, 1, 7, 2, 6, 6, 5, 5), *(0, 9, 10, 8, 8, 8, 8, 10, 10)]


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
        assert list(file_ids("virtual_kitti", table, names).values()) == ids


@pytest.mark.parametrize(("labels", "table"), [
    ("camvid", "cityscapes"), ("cityscapes", "virtual_kitti"), ("virtual_kitti", "ade20k"),
])  # fmt: skip
def test_a_pair_that_mixes_up_classes_is_refused(labels, table):
    with pytest.raises(DatasetError, match=rf"{labels} .*'{table}'.*camvid"):
        class_ids(labels, table)
    with pytest.raises(DatasetError, match=labels):
        class_ids(labels, CLASS_TABLES["camvid"])


def test_a_network_without_classes_is_scored_in_the_table_it_was_trained_with():
    trained = TrainingFacts(recipe={"model": {"classes": "cityscapes"}})
    assert trained_classes((), trained) == "cityscapes"
    assert trained_classes((), TrainingFacts()) == "camvid"


def test_classes_of_no_table_are_a_table_of_their_own():
    own = numbered_classes(3)
    assert trained_classes(own, TrainingFacts()) == own
    table = [{"name": info.name, "color": list(info.color)} for info in own]
    trained = TrainingFacts(recipe={"model": {"classes": table}})
    assert trained_classes((), trained) == own


def test_a_file_has_the_classes_of_camvid_whatever_its_colours():
    """A bundled file keeps the colours of its release."""
    with Predictor(warmup=0) as predictor:
        classes = tuple(predictor.contract.classes)
    assert [info.name for info in classes] == [info.name for info in CAMVID_CLASSES]
    assert trained_classes(classes, TrainingFacts()) == "camvid"
    gray = tuple(dataclasses.replace(info, color=(9, 9, 9)) for info in CAMVID_CLASSES)
    assert trained_classes(gray, TrainingFacts()) == "camvid"
    assert trained_classes(classes[:5], TrainingFacts()) == classes[:5]
