"""Recipes by name from the installed package."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from runtime.errors import InputError
from training import recipes
from training.cli import app
from training.recipe import read_recipe
from training.recipe_files import find_recipe, list_recipes

FOLDER = Path(recipes.__file__).parent


def test_every_recipe_has_a_name_of_its_own():
    assert sorted(list_recipes().values()) == sorted(FOLDER.rglob("*.toml"))
    assert find_recipe("cityscapes") == FOLDER / "cityscapes.toml"
    assert find_recipe("ablation-ssdnet") == FOLDER / "ablation" / "ssdnet.toml"
    assert read_recipe(find_recipe("vkitti")).model.classes == "virtual_kitti"


def test_what_ends_in_toml_or_holds_a_slash_is_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text in ("lite.toml", "./lite", "/a/lite", "ablation/ssdnet"):
        assert find_recipe(text) == Path(text)


def test_unknown_names_list_the_known():
    with pytest.raises(InputError, match=r"unknown recipe 'city'; known: cityscapes, kitti-depth"):
        find_recipe("city")
    result = CliRunner().invoke(app, ["city", "--data", "x", "--out", "y"])
    assert result.exit_code == 1
    assert "unknown recipe 'city'; known: cityscapes" in result.output


def test_list_needs_no_other_option():
    result = CliRunner().invoke(app, ["--list"])
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert [line.split()[0] for line in lines] == list(list_recipes())
    assert all(len(line.split()) > 3 and line.endswith(".") for line in lines)
