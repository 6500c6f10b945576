"""Frames of a user's own, scored by one short line; names that differ give no verdict."""

import json
import tomllib

import numpy as np
import pytest

from layouts.evaluation import run as evaluate
from layouts.pictures import write

COLORS = np.uint8([[128, 64, 128], [0, 0, 142], [70, 130, 180]])


@pytest.fixture
def frames(tmp_path):
    """Six frames of three stripes, labels as ids and in colours, and right answers."""
    ids = np.repeat(np.arange(3, dtype=np.uint8)[:, None], 64, 1).repeat([16, 16, 1], 0)
    for index in range(6):
        for folder, picture in (("images", COLORS[ids]), ("labels", ids), ("colors", COLORS[ids])):
            write(tmp_path / f"{folder}/{index}.png", picture)
        write(tmp_path / f"theirs/{index}.png", ids)
        write(tmp_path / f"wrong/{index}.png", np.roll(ids, 1, 0))
    (tmp_path / "classes.txt").write_text("drivable = road\nautomobile\nsky\ngizmo\n")
    (tmp_path / "colors.txt").write_text("drivable 128 64 128\nautomobile 0 0 142\nsky 70 130 180")
    return tmp_path


def run(folder, *further, labels="labels", classes="classes.txt"):
    names = ',classes=["road","car","sky"]'
    answers = [("--predictions", f"{folder}/{name}{names}") for name in ("theirs", "wrong")]
    given = ["--images", folder / "images", "--labels", folder / labels]
    given += ["--classes", folder / classes] if classes else []
    return evaluate(*sum(answers, ()), *given, *further)


def test_no_verdict_before_classes_are_joined_by_their_meaning(frames):
    page = frames / "page.html"
    first = run(frames, "--page", page)
    assert first.exit_code == 0, first.output
    assert "no verdict: 3% of the labels are scored" in first.output
    assert f"--join {page.with_suffix('.join.toml')} --overwrite" in first.output
    text = page.with_suffix(".join.toml").read_text()
    groups = {"drivable": ["drivable", "road"], "automobile": ["automobile", "car"]}
    assert tomllib.loads(text) == {**groups, "gizmo": ["gizmo"]}
    assert "# Add by hand what these mean in the models, or leave them: gizmo\n" in text
    assert first.output.count("left out of the mean") == 1
    options = ("--join", page.with_suffix(".join.toml"), "--json", frames / "rows.json")
    second = run(frames, *options)
    assert "| worse |" in " ".join(second.output.split())
    first, second = json.loads((frames / "rows.json").read_text())
    assert first["data"].endswith("/images")
    assert (first["scored_labels"], first["figures"]["miou"]) == (1, 1)
    assert second["figures"]["miou"] < 1
    assert "category_miou" not in first["figures"]


def test_labels_may_be_in_colours(frames):
    lines = [run(frames, labels=name, classes=file).output.splitlines()[2] for name, file in (
        ("labels", "classes.txt"), ("colors", "colors.txt"),
    )]  # fmt: skip
    assert lines[0] == lines[1]
    assert "100.00" in lines[0]


@pytest.mark.parametrize(("options", "text"), [
    (["--classes", "c.txt"], "belong to --images"),
    (["--images", "i", "--classes", "c.txt"], "--classes belongs to --labels"),
    (["--images", "i", "--depth-scale", "2"], "--depth-scale belongs to --depth"),
])  # fmt: skip
def test_options_that_need_another_are_refused(options, text):
    result = evaluate("ssdnet-nano", *options)
    assert result.exit_code == 1
    assert text in result.output
