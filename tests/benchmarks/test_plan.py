"""What is trained, exported and scored from a file: how it is read, and what is done once."""

import hashlib
from dataclasses import asdict
from types import SimpleNamespace

import pytest

import plan as plans
from runtime.errors import InputError
from training.datasets.camvid import CamVidRecipe
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
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def test_a_plan_is_read_whole(tmp_path):
    path = write_plan(tmp_path, PLAN + '[[candidate]]\nname = "depth"\nrecipe = "lite-depth"\n')
    plan = plans.read_plan(path, ["loop.ema_decay = 0.5"], None, onnx=["x/mine.onnx"])
    assert plan.set == ("schedule.steps = 7", "loop.ema_decay = 0.5")
    assert [item.name for item in plan.candidates] == ["thin one", "shipped", "depth", "mine"]
    assert [item.folder for item in plan.candidates] == ["thin-one", "shipped", "depth", "mine"]
    assert [item.recipe for item in plan.candidates] == ["lite", None, "lite-depth", None]
    assert plan.candidates[3].onnx == "x/mine.onnx"
    thin = plans.read_candidate(plan.candidates[0], plan)
    assert thin.model.config == {"boundary_channels": 8}
    assert thin.schedule.steps == 7
    assert thin.loop.ema_decay == 0.5
    only = plans.read_plan(path, [], ["shipped"])
    assert [item.name for item in only.candidates] == ["shipped"]


@pytest.mark.parametrize(
    ("text", "onnx", "only", "said"),
    [
        (PLAN.replace("set =", "sets =", 1), [], None, "unknown key sets"),
        (PLAN.replace("onnx =", "onyx ="), [], None, "unknown key onyx"),
        (PLAN.replace('recipe = "lite"', ""), [], None, "no recipe to train 'thin one' by"),
        (PLAN.replace("shipped", "thin:one"), [], None, "two candidates are called 'thin-one'"),
        (PLAN, ["a/shipped.onnx"], None, "two candidates are called 'shipped'"),
        (PLAN, [], ["thin"], "--only 'thin': no such candidate; known: thin one, shipped"),
        ("recipe =", [], None, "cannot be read"),
    ],
)
def test_a_bad_plan_is_refused(tmp_path, text, onnx, only, said):
    with pytest.raises(InputError, match=said):
        plans.read_plan(write_plan(tmp_path, text), [], only, onnx=onnx)


def test_a_candidate_is_trained_once_and_exported_when_its_weights_change(tmp_path, monkeypatch):
    calls = []

    def train(recipe, *, data, out, init, device, stop):
        calls.append("train")
        out.mkdir(parents=True)
        (out / plans.RECIPE).write_text(to_text({"recipe": asdict(recipe)}))
        (out / plans.FINAL).write_bytes(b"weights")
        return out / plans.FINAL

    def export(checkpoint, onnx, *, size, dynamic, overwrite):
        calls.append("export")
        onnx.write_bytes(hashlib.sha256(checkpoint.read_bytes()).hexdigest().encode())

    def contract_of(path):
        return SimpleNamespace(contract=SimpleNamespace(checkpoint_sha256=path.read_text()))

    monkeypatch.setattr(plans, "train", train)
    monkeypatch.setattr(plans, "export_checkpoint", export)
    monkeypatch.setattr(plans, "load_model_file", contract_of)
    arguments = SimpleNamespace(runs=tmp_path / "runs", data=[tmp_path], device="cpu")
    plan = plans.read_plan(write_plan(tmp_path), [], ["thin one"])

    def make(plan, stopped=False):
        return plans.find_or_make(plan.candidates[0], plan, arguments, lambda: stopped)

    onnx = make(plan)
    assert onnx == tmp_path / "runs/thin-one/model.onnx"
    assert make(plan) == onnx
    assert calls == ["train", "export"]
    (onnx.parent / plans.FINAL).write_bytes(b"other weights")
    make(plan)
    assert calls == ["train", "export", "export"]
    assert make(plan, stopped=True) is None
    other = plans.read_plan(write_plan(tmp_path), ["schedule.steps = 8"], ["thin one"])
    with pytest.raises(InputError, match=r"schedule\.steps was 7, now it is 8"):
        make(other)


def test_scores_are_kept_until_the_file_the_sets_or_the_limit_change(tmp_path, monkeypatch):
    calls = []

    def evaluate(models, data, *, lidars, methods, **_):
        calls.append((*models, *methods))
        return [SimpleNamespace(lidar=str(lidar), figures={"miou": 0.5}) for lidar in lidars]

    monkeypatch.setattr(plans, "evaluate", evaluate)
    content = {"sha256": "one"}
    monkeypatch.setattr(plans, "load_model_file", lambda _: SimpleNamespace(**content))
    sets = {"camvid": (CamVidRecipe(path="x", split="val"), ["none", "64"])}
    arguments = SimpleNamespace(threads=1, limit=None)

    def score(onnx="model.onnx", method=""):
        return plans.find_or_score(tmp_path / "run", sets, arguments, onnx=onnx, method=method)

    assert score() == {"camvid none": {"miou": 0.5}, "camvid 64": {"miou": 0.5}}
    assert score() == score()
    assert calls == [("model.onnx",)]
    content["sha256"] = "two"
    score()
    arguments.limit = 3
    score()
    assert calls == [("model.onnx",)] * 3
    score(onnx=None, method="nearest")
    assert calls[3:] == [("nearest",)]
    assert score(onnx=None, method="nearest")
    assert len(calls) == 4
