"""Whose a run folder is: what changes the result must be the same, and is named if it is not."""

import json
from dataclasses import asdict, replace

import pytest

from runtime.errors import InputError
from training.datasets.camvid import CamVidRecipe
from training.recipe import DataRecipe, ModelRecipe, Recipe, ScheduleRecipe, ValidationRecipe
from training.run_folder import RECIPE, prepare_folder

SET = CamVidRecipe(path="camvid")
FILES = {"camvid": {"files": 3, "sha256": "0"}}
FIRST = Recipe(ModelRecipe("ssdnet-lite"), DataRecipe((SET,)), ScheduleRecipe(steps=9))


def resolved(recipe=FIRST, **changes):
    return {"recipe": asdict(recipe), "init": None, "processes": 1, **changes}


def test_what_does_not_change_the_weights_may_change(tmp_path):
    prepare_folder(tmp_path, resolved(), FILES)
    other = replace(
        FIRST,
        data=replace(FIRST.data, workers=5, cache_gib=2.0),
        loop=replace(FIRST.loop, log_every=3, checkpoint_every=7),
        validation=ValidationRecipe(every=5, pictures=1),
        terms="none",
    )
    prepare_folder(tmp_path, resolved(other), FILES)
    assert json.loads((tmp_path / RECIPE).read_text())["recipe"]["data"]["workers"] == 5


def test_a_key_that_a_release_added_counts_with_its_default(tmp_path):
    prepare_folder(tmp_path, resolved(), FILES)
    document = json.loads((tmp_path / RECIPE).read_text())
    # As an earlier release wrote it, which did not know these.
    del document["recipe"]["loop"]["clip_norm"]
    del document["recipe"]["data"]["augment"]["hue_deg"]
    del document["recipe"]["data"]["source"][0]["split"]
    (tmp_path / RECIPE).write_text(json.dumps(document))
    prepare_folder(tmp_path, resolved(), FILES)
    (tmp_path / RECIPE).write_text(json.dumps(document))
    other = replace(FIRST, loop=replace(FIRST.loop, clip_norm=1.0))
    with pytest.raises(InputError, match=r"loop\.clip_norm was 0\.0, now it is 1\.0"):
        prepare_folder(tmp_path, resolved(other), FILES)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"schedule": ScheduleRecipe(steps=10)}, r"schedule\.steps was 9, now it is 10"),
        ({"data": replace(FIRST.data, seed=3)}, r"data\.seed was 0, now it is 3"),
        (
            {"data": replace(FIRST.data, source=(replace(SET, split="val"),))},
            r"data\.source\[0\]\.split was 'train', now it is 'val'",
        ),
        (
            {"data": replace(FIRST.data, source=(SET, SET))},
            r"data\.source\[1\]\.kind was None, now it is 'camvid'",
        ),
        (
            {"validation": ValidationRecipe(source=(SET,))},
            r"validation\.source\[0\]\.kind was None, now it is 'camvid'",
        ),
        (
            {"validation": ValidationRecipe(lidar="none")},
            r"validation\.lidar was 'own', now it is 'none'",
        ),
    ],
    ids=str,
)
def test_what_changes_them_is_named(tmp_path, changes, text):
    prepare_folder(tmp_path, resolved(), FILES)
    before = (tmp_path / RECIPE).read_bytes()
    with pytest.raises(InputError, match=f"another recipe: {text}"):
        prepare_folder(tmp_path, resolved(replace(FIRST, **changes)), FILES)
    assert (tmp_path / RECIPE).read_bytes() == before


def test_processes_and_first_weights_are_named(tmp_path):
    prepare_folder(tmp_path, resolved(), FILES)
    with pytest.raises(InputError, match="processes was 1, now it is 2"):
        prepare_folder(tmp_path, resolved(processes=2), FILES)
    with pytest.raises(InputError, match=r"init was None, now it is 'a\.pt"):
        prepare_folder(tmp_path, resolved(init="a.pt (sha256 0)"), FILES)


@pytest.mark.parametrize("text", ["", "[]", '{"recipe": 3}', '{"recipe": {"loop": {"x": 1}}}'])
def test_a_file_that_is_no_recipe_is_refused(tmp_path, text):
    (tmp_path / RECIPE).write_text(text)
    with pytest.raises(InputError, match=r"recipe\.json"):
        prepare_folder(tmp_path, resolved(), FILES)
