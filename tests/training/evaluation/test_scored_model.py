"""Models as they are scored: their names and class tables."""

import dataclasses
from pathlib import Path

from models import CAMVID_CLASSES
from models.classes import numbered_classes
from models.training_facts import TrainingFacts
from runtime import Predictor
from training.evaluation.evaluate import short_names
from training.evaluation.scored_model import trained_classes


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


def test_paths_of_equal_names_get_more_of_their_parts():
    assert short_names([Path("a/model.pt"), Path("b/model.pt")]) == ["a/model.pt", "b/model.pt"]
    assert short_names([Path("x/a/1"), Path("x/a/2")]) == ["1", "2"]
    assert short_names([Path()]) == ["."]
