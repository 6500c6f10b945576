"""The comparison: its queue from the command line, what ships, and the tables."""

import json
import sys

import numpy as np
import pytest

import ablation
import comparison
from layouts import camvid, kitti_streets, virtual_kitti
from models import list_models
from plan import read_candidate, read_plan
from runtime.errors import InputError
from runtime.model_file import load_model_file

PLAN = """
recipe = "comparison-semantics"
set = ["data.batch_size = 2", "data.augment.crop = [32, 64]", "schedule.warmup_steps = 0"]
[[candidate]]
name = "semantic"
set = ['model.name = "fast-scnn"']
published_miou = 51.0
[[candidate]]
name = "depth"
recipe = "comparison-depth"
set = [
    'model.name = "nconv"',
    "data.source = [{ kind = 'rendered', path = 'rendered/val' }]",
]
[[candidate]]
name = "big"
network = "enet"
[[candidate]]
name = "filling"
method = "nearest"
"""


@pytest.fixture
def data(tmp_path):
    label = np.full((40, 72), 3, np.uint8)
    label[:20] = 1
    rgb = np.full((*label.shape, 3), 90, np.uint8)
    for split in ("train", "val"):
        camvid.write_frame(tmp_path / "data" / "camvid", rgb, label, split=split)
    kitti_streets.write_streets(tmp_path / "data" / "kitti_streets", (2, 83), magnify=5)
    virtual_kitti.write_second_edition(tmp_path / "data" / "rendered" / "val", magnify=5)
    return tmp_path / "data"


@pytest.fixture
def plan_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def run(verb, plan_file, *options, steps=2):
    runs = plan_file.parent / "runs"
    command = [verb, "--plan", plan_file, "--runs", runs, "--threads", 1]
    comparison.main(list(map(str, [*command, "--set", f"schedule.steps = {steps}", *options])))
    return runs


def test_the_queue_trains_scores_times_and_shows(data, plan_file, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(comparison, "SIZES", [(64, 96)])
    runs = run("train", plan_file, "--data", data)
    shown = capsys.readouterr().out
    assert "semantic {'camvid none miou': " in shown
    # No simulated line meets a scene as small as this: what is fed is none.
    scored = {"streets 64", "streets 16", "rendered none"}
    for name in ("depth", "filling"):
        assert json.loads((runs / name / "scores.json").read_text())["figures"].keys() == scored
    assert load_model_file(runs / "depth" / "model.onnx").contract.model_name == "nconv"
    assert not (runs / "big").exists()

    run("time", plan_file, "--rounds", 2)
    run("table", plan_file, "--markdown", tmp_path / "table.md")
    lines = (tmp_path / "table.md").read_text().splitlines()
    rows = {line.split(" | ")[0]: line.split(" | ") for line in lines if line.count("|") > 5}
    assert lines.count("**Semantics**") == 1
    name, trained, miou, published, params, gmacs, ms = rows["| semantic"]
    assert trained == "4 samples"
    assert 0 <= float(miou) <= 100
    assert published == "51"
    assert float(params) == pytest.approx(1.1, abs=0.1)
    assert float(gmacs) > 0
    assert float(ms.rstrip(" |")) > 0
    assert rows["| big"][1:4] == ["not trained here", "", ""]
    name, trained, first, second, stream, rendered, params, *_ = rows["| depth"]
    assert all(" / " in cell for cell in (first, second))
    assert stream == rendered == ""
    assert float(params) < 0.01
    assert rows["| filling"][1] == "no training"
    assert rows["| filling"][6:8] == ["", ""]


def test_what_is_done_is_not_done_again_and_failures_do_not_stop_the_rest(
    data, plan_file, monkeypatch, capsys
):
    only = ("--only", "depth", "filling")
    run("train", plan_file, "--data", data, *only)
    before = capsys.readouterr().out

    def again(*_, **__):
        raise InputError("once more")

    monkeypatch.setattr("plan.train", again)
    monkeypatch.setattr("plan.evaluate", again)
    run("train", plan_file, "--data", data, *only)
    assert capsys.readouterr().out == before
    with pytest.raises(SystemExit, match="1 left out: depth"):
        run("train", plan_file, "--data", data, *only, steps=3)
    out = capsys.readouterr().out
    assert "depth: left out" in out
    assert "steps was 2, now it is 3" in out
    assert "filling {" in out


def test_a_stopped_queue_says_so_and_the_ablation_comes_last(data, plan_file, monkeypatch):
    asked = []
    monkeypatch.setattr(ablation, "main", asked.append)
    options = ("--data", data, "--ablation", data, "--only", "filling", "--limit", 1)
    runs = run("train", plan_file, *options)
    assert asked[0][:4] == ["--data", str(data), "--runs", str(runs / "ablation")]
    monkeypatch.setattr(comparison, "find_or_make", lambda *_: None)
    with pytest.raises(SystemExit) as stopped:
        run("train", plan_file, "--data", data, "--ablation", data, "--only", "semantic")
    assert stopped.value.code == comparison.INTERRUPTED
    assert len(asked) == 1


def test_bad_names_are_refused_before_anything_is_trained(data, plan_file):
    for change, said in (
        (("nearest", "furthest"), "furthest"),
        (('"enet"', '"ednet"'), "no network 'ednet'; known: .*enet"),
        (("fast-scnn", "fast"), "fast"),
    ):
        plan_file.write_text(PLAN.replace(*change))
        with pytest.raises(SystemExit, match=said):
            run("train", plan_file, "--data", data)
    assert not (plan_file.parent / "runs").exists()
    plan_file.write_text(PLAN)
    with pytest.raises(InputError, match="is none of camvid: nothing to score on"):
        comparison.find_sets(("semantic",), [plan_file.parent])


def test_the_plan_that_ships_trains_all_of_a_task_alike():
    path = comparison.Path(comparison.__file__).with_suffix(".toml")
    plan = read_plan(path, [], None, kind=comparison.Entry)
    named = {item.network for item in plan.candidates}
    budgets = {}
    for item in plan.candidates:
        comparison.heads_of(item, plan)
        if item.is_trained:
            recipe = read_candidate(item, plan)
            named.add(recipe.model.name)
            budgets.setdefault(item.recipe, set()).add(
                (recipe.data, recipe.schedule, recipe.optimizer, recipe.loop)
            )
    assert set(budgets) == {"comparison-semantics", "comparison-depth"}
    assert all(len(settings) == 1 for settings in budgets.values())
    # Every other people's network is there.
    assert {name for name in list_models() if not name.startswith("ssdnet")} <= named


def test_the_program_is_started_by_its_name(plan_file, monkeypatch):
    command = ["comparison.py", "table", "--plan", plan_file, "--runs", plan_file.parent, "--only"]
    monkeypatch.setattr(sys, "argv", [str(part) for part in [*command, "filling"]])
    comparison.main()
