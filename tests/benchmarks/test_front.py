"""The front: a run from the command line, and who is on it."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import front
import plan as plan_module
from layouts import camvid, kitti_streets
from plan import read_candidate
from runtime.bundled_models import find_model
from runtime.errors import InputError
from training.network import build_network


def write_plan(folder, text):
    path = folder / "front.toml"
    path.write_text(text)
    return path


def test_the_plan_that_ships_is_one_whose_recipes_can_be_read():
    plan = front.read_plan(Path(front.__file__).with_suffix(".toml"), [], None)
    trained = [item for item in plan.candidates if item.onnx is None]
    assert trained
    for item in trained:
        model = read_candidate(item, plan).model
        assert build_network(model, None).config.name == model.name


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

    monkeypatch.setattr(plan_module, "evaluate", score_again)
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
