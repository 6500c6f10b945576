"""Options that go together, and those that do not."""

from pathlib import Path

import pytest

from runtime.app.run.options import KINDS, RunOptions, UsageError


@pytest.mark.parametrize(("texts", "kinds"), [
    (["all,cloud"], {*KINDS, "cloud"}), (["cloud", "all"], {*KINDS, "cloud"}),
    (["all"], set(KINDS)), (["none"], set()), (["depth", "cloud"], {"depth", "cloud"}),
    (None, set(KINDS)),
])  # fmt: skip
def test_all_adds_to_other_kinds(texts, kinds):
    assert set(RunOptions(demo=True, save=texts).kinds) == kinds


@pytest.mark.parametrize("texts", [["none,cloud"], ["everything"], ["all,clouds"]], ids=str)
def test_kinds_that_are_none_are_refused(texts):
    with pytest.raises(UsageError, match="--save is none"):
        RunOptions(demo=True, save=texts)


def test_depth_maps_are_not_rectified():
    with pytest.raises(UsageError, match="--rectify goes with --points"):
        RunOptions(rgb=Path("images"), depth=Path("depth"), rectify=True)
