"""Whose a run folder is: what changes the result must be the same, and is named if it is not."""

import json
from dataclasses import asdict

import pytest

from models.checkpoint import FINAL, RECIPE
from runtime.base.errors import InputError
from training.datasets.camvid import CamVidRecipe
from training.loading.data_recipe import DataRecipe
from training.run.network import ModelRecipe
from training.run.optimizer import ScheduleRecipe
from training.run.recipe import Recipe, derive
from training.run.run_folder import list_data, prepare_folder

SET = CamVidRecipe(path="camvid")
FILES = {"camvid": {"files": 3, "sha256": "0"}}
FIRST = Recipe(ModelRecipe("ssdnet-lite"), DataRecipe((SET,)), ScheduleRecipe(steps=9))


def resolved(recipe=None, **changes):
    run = asdict(derive(FIRST, **(recipe or {})))
    return {"recipe": run, "init": None, "processes": 1, **changes}


def test_what_does_not_change_the_weights_may_change(tmp_path):
    prepare_folder(tmp_path, resolved(), FILES, [])
    other = {
        "data": {"workers": 5, "cache_gib": 2.0},
        "loop": {"log_every": 3, "checkpoint_every": 7},
        "validation": {"every": 5, "pictures": 1},
        "terms": "none",
    }
    prepare_folder(tmp_path, resolved(other), FILES, [])
    assert json.loads((tmp_path / RECIPE).read_text())["recipe"]["data"]["workers"] == 5


def test_a_key_that_a_release_added_counts_with_its_default(tmp_path):
    prepare_folder(tmp_path, resolved(), FILES, [])
    document = json.loads((tmp_path / RECIPE).read_text())
    # As an earlier release wrote it, which did not know these.
    del document["recipe"]["loop"]["clip_norm"]
    del document["recipe"]["data"]["augment"]["hue_deg"]
    del document["recipe"]["data"]["source"][0]["split"]
    (tmp_path / RECIPE).write_text(json.dumps(document))
    prepare_folder(tmp_path, resolved(), FILES, [])
    (tmp_path / RECIPE).write_text(json.dumps(document))
    other = {"loop": {"clip_norm": 1.0}}
    with pytest.raises(InputError, match=r"loop\.clip_norm was 0\.0, now it is 1\.0"):
        prepare_folder(tmp_path, resolved(other), FILES, [])


@pytest.mark.parametrize(("changes", "text"), [
    ({"processes": 2}, "processes was 1, now it is 2"),
    ({"init": "a.pt (sha256 0)"}, r"init was None, now it is 'a\.pt"),
    ({"recipe": {"schedule": {"steps": 10}}}, r"schedule\.steps was 9, now it is 10"),
    (
        {"recipe": {"data": {"source": (SET, SET)}}},
        r"data\.source\[1\]\.kind was None, now it is 'camvid'",
    ),
    (
        {"recipe": {"validation": {"lidar": "none"}}},
        r"validation\.lidar was 'own', now it is 'none'",
    ),
], ids=str)  # fmt: skip
def test_what_changes_them_is_named(tmp_path, changes, text):
    prepare_folder(tmp_path, resolved(), FILES, [])
    before = (tmp_path / RECIPE).read_bytes()
    with pytest.raises(InputError, match=f"another recipe: {text}"):
        prepare_folder(tmp_path, resolved(**changes), FILES, [])
    assert (tmp_path / RECIPE).read_bytes() == before
    (tmp_path / FINAL).touch()
    with pytest.raises(InputError, match=r"is finished: train on from it, --init .*model\.pt"):
        prepare_folder(tmp_path, resolved(**changes), FILES, [])


@pytest.mark.parametrize("text", ['{"recipe": {', "[]", "{}", '{"recipe": 1}'])
def test_a_damaged_file_is_named(tmp_path, text):
    (tmp_path / RECIPE).write_text(text)
    with pytest.raises(InputError, match=r"recipe\.json: is not the recipe of a run"):
        prepare_folder(tmp_path, resolved(), FILES, [])


def test_other_data_than_at_the_start_are_named(tmp_path, capsys):
    files = tmp_path / "data" / "camvid"
    files.mkdir(parents=True)
    for name in "ab":
        (files / name).touch()

    def start(root):
        prepare_folder(tmp_path / "run", resolved(), list_data([tmp_path, root], ["camvid"]), [])
        return capsys.readouterr().err

    assert start(tmp_path / "data") == ""
    moved = (tmp_path / "data").rename(tmp_path / "moved")
    assert start(moved) == ""
    (moved / "camvid" / "a").rename(moved / "camvid" / "c")
    assert "warning: camvid: the 2 files have other names than when the run began" in start(moved)
    (moved / "camvid" / "c").write_bytes(b"12345")
    assert "the 2 files have other names" in start(moved)
    for content in (b"12345", b"12354"):  # relabelled, in as many bytes
        (tmp_path / "relabelled").mkdir(exist_ok=True)
        (tmp_path / "relabelled/a.png").write_bytes(content)
        files = list_data([tmp_path], ["relabelled", "relabelled/a.png"])
        prepare_folder(tmp_path / "other", resolved(), files, [])
    found = capsys.readouterr().err
    for name in ("relabelled", "relabelled/a.png"):  # a folder, and a file as a bag is one
        assert f"warning: {name}: the files have another content" in found
    (moved / "camvid" / "c").unlink()
    assert "warning: camvid: 2 files when the run began, now 1" in start(moved)


def test_a_set_that_was_moved_is_the_same_data(tmp_path, capsys):
    """The path in the recipe may differ, but the files may not."""
    place = tmp_path / "disk"
    place.mkdir()
    for name in "ab":
        (place / name).write_bytes(b"123")

    def start(path):
        recipe = {"data": {"source": (CamVidRecipe(path=str(path)),)}}
        files = list_data([tmp_path], [str(path)])
        prepare_folder(tmp_path / "run", resolved(recipe=recipe), files, [])

    start(place)
    place = place.rename(tmp_path / "mount")
    start(place)
    start(place)
    assert capsys.readouterr().err == ""
    document = json.loads((tmp_path / "run" / RECIPE).read_text())
    assert document["data_files"].keys() == {str(place)}
    place = place.rename(tmp_path / "other")
    for name, content in (("b", b"1234"), ("c", b"123")):
        (place / "b").unlink()
        (place / name).write_bytes(content)
        with pytest.raises(InputError, match="path was"):
            start(place)
