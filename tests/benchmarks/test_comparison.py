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

#: Networks that are quickly exported.
PLAN = """
recipe = "comparison-semantics"
set = ["data.batch_size = 2", "data.augment.crop = [32, 64]", "schedule.warmup_steps = 0"]
[[candidate]]
name = "semantic"
set = [
    "model.config.encoder_channels = [8]",
    "model.config.encoder_blocks = [1]",
    "model.config.decoder_channels = [8]",
]
published_miou = 51.0
[[candidate]]
name = "depth"
recipe = "comparison-depth"
set = [
    'model.name = "sparse-conv"',
    "data.source = [{ kind = 'rendered', path = 'rendered/val' }]",
]
[[candidate]]
name = "big"
network = "sparse-conv"
[[candidate]]
name = "filling"
method = "nearest"
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    label = np.full((40, 72), 3, np.uint8)
    label[:20] = 1
    rgb = np.full((*label.shape, 3), 90, np.uint8)
    for split in ("train", "val"):
        camvid.write_frame(root / "camvid", rgb, label, split=split)
    kitti_streets.write_streets(root / "kitti_streets", (2, 83), magnify=5)
    virtual_kitti.write_second_edition(root / "rendered" / "val", magnify=5)
    return root


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """The runs of the whole plan."""
    plan = tmp_path_factory.mktemp("trained") / "plan.toml"
    plan.write_text(PLAN)
    run("train", plan, "--data", data)
    return plan


@pytest.fixture
def plan_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def run(verb, plan, *options, steps=2):
    runs = plan.parent / "runs"
    command = [verb, "--plan", plan, "--runs", runs, "--threads", 1]
    comparison.main(list(map(str, [*command, "--set", f"schedule.steps = {steps}", *options])))
    return runs


def test_the_queue_trains_scores_times_and_shows(trained, tmp_path, monkeypatch):
    runs = trained.parent / "runs"
    # No simulated line meets a scene as small as this: what is fed is none.
    scored = {"streets 64", "streets 16", "rendered none"}
    for name in ("depth", "filling"):
        assert json.loads((runs / name / "scores.json").read_text())["figures"].keys() == scored
    assert load_model_file(runs / "depth" / "model.onnx").contract.model_name == "sparse-conv"
    assert not (runs / "big").exists()

    monkeypatch.setattr(comparison, "SIZES", [(64, 96)])
    run("time", trained, "--rounds", 2)
    run("table", trained, "--markdown", tmp_path / "table.md")
    lines = (tmp_path / "table.md").read_text().splitlines()
    rows = {line.split(" | ")[0]: line.split(" | ") for line in lines if line.count("|") > 5}
    assert lines.count("**Semantics**") == 1
    _, samples, miou, published, params, gmacs, ms = rows["| semantic"]
    assert samples == "4 samples"
    assert 0 <= float(miou) <= 100
    assert published == "51"
    assert 0 < float(params) < 0.1
    assert float(gmacs) > 0
    assert float(ms.rstrip(" |")) > 0
    _, samples, first, second, stream, rendered, params, gmacs, ms = rows["| depth"]
    assert samples == "4 samples"
    assert all(" / " in cell for cell in (first, second))
    assert stream == rendered == ""
    assert float(params) == pytest.approx(0.0256, rel=0.01)
    assert rows["| big"][1:6] == ["not trained here", "", "", "", ""]
    assert rows["| big"][6] == params
    assert rows["| filling"][1] == "no training"
    assert rows["| filling"][6:8] == ["", ""]


def test_what_is_done_is_not_done_again_and_failures_do_not_stop_the_rest(
    data, trained, monkeypatch, capsys
):
    def again(*_, **__):
        raise InputError("once more")

    monkeypatch.setattr("plan.train", again)
    monkeypatch.setattr("plan.evaluate", again)
    only = ("--only", "depth", "filling")
    run("train", trained, "--data", data, *only)
    with pytest.raises(SystemExit, match="1 left out: depth"):
        run("train", trained, "--data", data, *only, steps=3)
    out = capsys.readouterr().out
    assert "depth: left out" in out
    assert "steps was 2, now it is 3" in out
    assert out.count("filling {") == 2


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
        (('network = "sparse', 'network = "dense'), "no network 'dense-conv'; known: .*enet"),
        (('name = "sparse-conv"', 'name = "sparse"'), "sparse"),
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


def test_the_program_is_started_by_its_name(plan_file, monkeypatch, capsys):
    command = ["comparison.py", "table", "--plan", plan_file, "--runs", plan_file.parent, "--only"]
    monkeypatch.setattr(sys, "argv", [str(part) for part in [*command, "filling"]])
    comparison.main()
    assert "| filling | " in capsys.readouterr().out
