"""Recipes by name from the package, and TOML files of one's own."""

import pytest
from typer.testing import CliRunner

from models import list_models
from runtime.base.errors import InputError
from training.commands.train import app
from training.recipes.chosen_recipe import read_stages
from training.recipes.registry import RECIPES


@pytest.mark.parametrize("name", RECIPES)
def test_recipes_of_the_package_are_their_stages(name):
    stages = read_stages(name)
    assert stages == RECIPES[name].stages
    assert all(stage.recipe.model.name in list_models() for stage in stages)
    folders = [stage.folder for stage in stages]
    assert folders == [""] or [folder[:2] for folder in folders] == [
        f"{number}-" for number in range(1, len(stages) + 1)
    ]


def test_changes_are_of_every_stage():
    changed = read_stages("nano", ["schedule.steps = 600", "data.augment.lines = [4]"])
    assert [stage.recipe.schedule.steps for stage in changed] == [600] * 3
    assert [stage.recipe.data.augment.lines for stage in changed] == [(4,)] * 3
    assert [stage.recipe.data.seed for stage in changed] == [61, 62, 202]
    widths = "model.config.encoder_widths = [8]"
    with pytest.raises(InputError, match=r"lite: model\.config\.encoder_widths is not the same in"):
        read_stages("lite", [widths])  # the trunk is pruned between two stages
    with pytest.raises(InputError, match=r"nano: unknown key data\.sede"):
        read_stages("nano", ["data.sede = 1"])


def test_unknown_names_list_the_known():
    result = CliRunner().invoke(app, ["city", "--data", "x", "--out", "y"])
    assert result.exit_code == 1
    assert "unknown recipe 'city'; known: lite" in result.output


def test_list_needs_no_other_option():
    result = CliRunner().invoke(app, ["--list"])
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert [line.split()[0] for line in lines] == list(RECIPES)
    assert all(len(line.split()) > 3 and line.endswith(".") for line in lines)
