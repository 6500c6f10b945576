"""The facts of a training: of today's files, of older ones, and of strange ones."""

from dataclasses import replace

import pytest

from models import load_checkpoint
from models.training_facts import TrainingFacts
from runtime.contract.contract import ClassInfo
from training.weights.initial_weights import find_weights, list_weights

FACTS = TrainingFacts(("camvid",), "research", 400, {"model": {"classes": "cityscapes"}})


def test_plain_values_give_the_same_facts():
    assert TrainingFacts.from_dict(FACTS.to_dict()) == FACTS
    assert FACTS.classes == "cityscapes"


def test_what_a_file_lacks_has_its_default():
    assert TrainingFacts.from_dict({}) == TrainingFacts()
    assert (
        TrainingFacts.from_dict({"note": "another release's", "recipe": None}).classes == "camvid"
    )


def test_a_table_of_its_own_is_read():
    own = replace(FACTS, recipe={"model": {"classes": [{"name": "lane", "color": [1, 2, 3]}]}})
    assert own.classes == (ClassInfo("lane", (1, 2, 3)),)


@pytest.mark.parametrize("height", [0, -3, "400", True])
def test_a_height_that_no_image_has_is_refused(height):
    with pytest.raises(ValueError, match="trained_height"):
        TrainingFacts.from_dict({"trained_height": height})


@pytest.mark.parametrize("name", list_weights())
def test_the_files_of_today_are_read(name):
    facts = TrainingFacts.from_dict(load_checkpoint(find_weights(name)).training)
    assert {"camvid", "ImageNet"} & set(facts.data)
    assert "non-commercial" in facts.terms
    assert facts.trained_height == 400
    assert facts.classes == "camvid"
