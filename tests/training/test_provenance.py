"""Weights state the data and terms of all that they come from."""

import pytest

from models import create_model, save_checkpoint
from models.training_facts import TrainingFacts
from training.initial_weights import IMAGENET_TERMS, read_weights, state_provenance
from training.recipe import Recipe, build

RECIPE = {
    "terms": "CamVid: research; drawn scenes: ours",
    "model": {"name": "fast-scnn"},
    "data": {
        "batch_size": 1,
        "workers": 0,
        "augment": {"crop": [32, 32]},
        "source": [{"kind": "camvid", "path": "camvid"}, {"kind": "camvid", "path": "camvid"}],
    },
    "schedule": {"steps": 1},
}


@pytest.fixture
def recipe():
    return build(Recipe, RECIPE)


@pytest.fixture
def write(tmp_path):
    def write(name, **facts):
        path = tmp_path / f"{name}.pt"
        training = TrainingFacts(**facts).to_dict()
        save_checkpoint(path, create_model("fast-scnn"), training=training)
        return read_weights(path)

    return write


def test_a_training_from_random_weights_states_its_own_once(recipe):
    assert state_provenance(recipe, None, None) == (("camvid",), recipe.terms)


def test_what_it_begins_with_and_what_it_learns_from_is_stated_too(recipe, write):
    first = write("init", data=("streets", "camvid"), terms="Streets: non-commercial")
    teacher = write("teacher", data=("boston",), terms="drawn scenes: ours; Boston: share alike")
    data, terms = state_provenance(recipe, first, teacher)
    assert data == ("camvid", "streets", "boston")
    assert terms == f"{recipe.terms}; Streets: non-commercial; Boston: share alike"


def test_weights_of_imagenet_are_named(recipe):
    data, terms = state_provenance(
        build(Recipe, {**RECIPE, "model": {"name": "ssdnet-lite", "pretrained": "imagenet"}})
    )
    assert data == ("camvid", "ImageNet")
    assert terms == f"{recipe.terms}; {IMAGENET_TERMS}"
