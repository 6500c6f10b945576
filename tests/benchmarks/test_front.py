"""The front: what is done once, what is refused, and who is on it."""

import hashlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import front
from layouts import camvid, kitti_streets
from runtime.bundled_models import find_model
from runtime.errors import InputError
from training.network import build_network
from training.recipe import read_recipe
from training.recipe_files import find_recipe
from training.run_folder import to_text

PLAN = """
recipe = "lite"
set = ["schedule.steps = 7"]
[[candidate]]
name = "thin one"
set = ["model.config.boundary_channels = 8"]
[[candidate]]
name = "shipped"
onnx = "ssdnet-lite"
"""


def write_plan(folder, text=PLAN):
    path = folder / "front.toml"
    path.write_text(text)
    return path


def test_a_plan_is_read_whole(tmp_path):
    plan = front.read_plan(write_plan(tmp_path), ["loop.ema_decay = 0.5"], ["x/mine.onnx"], None)
    assert plan.recipe == "lite"
    assert plan.set == ("schedule.steps = 7", "loop.ema_decay = 0.5")
    assert [item.name for item in plan.candidates] == ["thin one", "shipped", "mine"]
    assert [item.folder for item in plan.candidates] == ["thin-one", "shipped", "mine"]
    assert plan.candidates[0].set == ("model.config.boundary_channels = 8",)
    assert plan.candidates[2].onnx == "x/mine.onnx"
    only = front.read_plan(write_plan(tmp_path), [], [], ["shipped"])
    assert [item.name for item in only.candidates] == ["shipped"]


@pytest.mark.parametrize(
    ("text", "onnx", "only", "said"),
    [
        (PLAN.replace("set =", "sets =", 1), [], None, "unknown key sets"),
        (PLAN.replace("onnx =", "onyx ="), [], None, "unknown key onyx"),
        (PLAN.replace('recipe = "lite"', ""), [], None, "names no recipe"),
        (PLAN.replace("shipped", "thin:one"), [], None, "two candidates are called 'thin-one'"),
        (PLAN, ["a/shipped.onnx"], None, "two candidates are called 'shipped'"),
        (PLAN, [], ["thin"], "--only 'thin': no such candidate; known: thin one, shipped"),
        ("recipe =", [], None, "cannot be read"),
    ],
)
def test_a_bad_plan_is_refused(tmp_path, text, onnx, only, said):
    with pytest.raises(InputError, match=said):
        front.read_plan(write_plan(tmp_path, text), [], onnx, only)


def test_the_plan_that_ships_is_one_whose_recipes_can_be_read():
    plan = front.read_plan(Path(front.__file__).with_suffix(".toml"), [], [], None)
    for item in plan.candidates:
        if item.onnx is None:
            recipe = read_recipe(find_recipe(plan.recipe), [*plan.set, *item.set])
            build_network(recipe.model, None)


def test_a_candidate_is_trained_once_and_exported_when_its_weights_change(tmp_path, monkeypatch):
    calls = []

    def train(recipe, *, data, out, init, device, stop):
        calls.append("train")
        out.mkdir(parents=True)
        (out / front.RECIPE).write_text(to_text({"recipe": asdict(recipe)}))
        (out / front.FINAL).write_bytes(b"weights")
        return out / front.FINAL

    def export(checkpoint, onnx, *, dynamic, overwrite):
        calls.append("export")
        onnx.write_bytes(hashlib.sha256(checkpoint.read_bytes()).hexdigest().encode())

    def contract_of(path):
        return SimpleNamespace(contract=SimpleNamespace(checkpoint_sha256=path.read_text()))

    monkeypatch.setattr(front, "train", train)
    monkeypatch.setattr(front, "export_checkpoint", export)
    monkeypatch.setattr(front, "load_model_file", contract_of)
    arguments = SimpleNamespace(runs=tmp_path / "runs", data=[tmp_path], device="cpu")
    plan = front.read_plan(write_plan(tmp_path), [], [], ["thin one"])

    def make(plan, stopped=False):
        return front.find_or_make(plan.candidates[0], plan, arguments, lambda: stopped)

    onnx = make(plan)
    assert onnx == tmp_path / "runs/thin-one/model.onnx"
    assert make(plan) == onnx
    assert calls == ["train", "export"]
    (onnx.parent / front.FINAL).write_bytes(b"other weights")
    make(plan)
    assert calls == ["train", "export", "export"]
    assert make(plan, stopped=True) is None
    other = front.read_plan(write_plan(tmp_path), ["schedule.steps = 8"], [], ["thin one"])
    with pytest.raises(InputError, match=r"schedule\.steps was 7, now it is 8"):
        make(other)


def test_a_run_scores_once_times_draws_and_says_who_failed(tmp_path, monkeypatch, capsys):
    label = np.full((40, 72), 3, np.uint8)
    camvid.write_frame(
        tmp_path / "camvid", np.full((*label.shape, 3), 90, np.uint8), label, split="val"
    )
    kitti_streets.write_streets(tmp_path / "kitti_streets", (2, 83), magnify=5)
    plan = write_plan(tmp_path, '[[candidate]]\nname = "shipped"\nonnx = "ssdnet-lite"\n')
    out = {name: tmp_path / f"out.{name}" for name in ("markdown", "json", "plot")}
    command = ["front.py", plan, "--data", tmp_path, "--runs", tmp_path / "runs", "--limit", 1]
    command += ["--onnx", find_model("ssdnet-lite"), tmp_path / "not-there.onnx"]
    command += ["--size", "64x96", "--rounds", 2, "--threads", 1]
    command += [part for name, path in out.items() for part in (f"--{name}", path)]
    monkeypatch.setattr(sys, "argv", [str(part) for part in command])
    with pytest.raises(SystemExit, match="1 left out: not-there"):
        front.main()
    document = json.loads(out["json"].read_text())
    first, second = document["rows"]
    assert [first["network"], second["network"]] == ["shipped", "ssdnet-lite"]
    assert first["scores"] == second["scores"]
    assert set(first["scores"]) == {"miou", "mae_64", "rmse_64", "mae_16", "rmse_16"}
    assert "| shipped | " in out["markdown"].read_text()
    assert cv2.imread(str(out["plot"])).shape[0] > 200

    def score_again(*args, **kwargs):
        raise InputError("scored again")

    monkeypatch.setattr(front, "evaluate", score_again)
    with pytest.raises(SystemExit, match="1 left out: not-there"):
        front.main()
    capsys.readouterr()
    sys.argv[sys.argv.index("--limit") + 1] = "2"
    with pytest.raises(SystemExit, match="no candidate could be"):
        front.main()
    assert "shipped: left out: scored again" in capsys.readouterr().out


def test_without_a_set_to_score_on(tmp_path):
    with pytest.raises(InputError, match="neither camvid nor kitti_streets"):
        front.find_sets([tmp_path])


def test_on_the_front_is_whom_none_beats_in_both():
    def row(name, ms, miou, mae):
        scores = {} if miou is None else {"miou": miou, "mae_64": mae}
        return {"network": name, "median_ms": ms, "scores": scores}

    rows = [
        row("slow and best", 50, 0.7, 0.9),
        row("slower, not better", 60, 0.7, 1.0),
        row("fast", 10, 0.5, 1.0),
        row("middle, worse than fast", 20, 0.4, 1.5),
        row("middle", 30, 0.6, 0.8),
        row("peer", 5, None, None),
    ]
    fronts = front.find_fronts(rows)
    assert fronts["miou"] == ["fast", "middle", "slow and best"]
    assert fronts["mae_64"] == ["fast", "middle"]
    assert fronts["rmse_64"] == []
