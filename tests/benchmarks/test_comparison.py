"""The comparison: how its file is read, its queue from the command line, and the tables."""

import hashlib
import json
import shutil
import signal
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import comparison
from comparison import Entry, read_plan, recipe_of
from layouts import camvid, kitti_streets, virtual_kitti
from models import list_models
from runtime.bundled_models import find_model
from runtime.errors import InputError

#: A network that is quickly trained, a bundled one, one that is only timed, and a method.
PLAN = """
recipe = "comparison-semantics"
set = ["data.batch_size = 2", "data.augment.crop = [32, 64]", "schedule.warmup_steps = 0"]
[[entry]]
name = "shipped"
onnx = "ssdnet-nano"
published_miou = 51.0
[[entry]]
name = "thin one"
recipe = "comparison-depth"
set = [
    'model.name = "sparse-conv"',
    "data.source = [{ kind = 'rendered', path = 'rendered/val' }]",
]
[[entry]]
name = "big"
network = "sparse-conv"
[[entry]]
name = "filling"
method = "nearest"
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    label = np.full((40, 72), 3, np.uint8)
    label[:20] = 1
    rgb = np.full((*label.shape, 3), 90, np.uint8)
    camvid.write_frame(root / "camvid", rgb, label, split="val")
    kitti_streets.write_streets(root / "kitti_streets", (83,), magnify=5)
    virtual_kitti.write_second_edition(root / "rendered" / "val", magnify=5)
    return root


@pytest.fixture
def plan_file(tmp_path):
    return write_plan(tmp_path)


@pytest.fixture
def export_nano(monkeypatch):
    """In place of an export, which takes long: the bundled network. Gives the list of exports."""
    exports = []

    def export(checkpoint, onnx, *, size, dynamic, overwrite):
        assert dynamic
        assert overwrite
        exports.append(checkpoint)
        shutil.copy(find_model("ssdnet-nano"), onnx)

    monkeypatch.setattr(comparison, "export_checkpoint", export)
    return exports


def write_plan(folder, text=PLAN):
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def run(verb, plan, *options, steps=2):
    runs = plan.parent / "runs"
    command = [verb, "--plan", plan, "--runs", runs, "--threads", 1]
    comparison.main(list(map(str, [*command, "--set", f"schedule.steps = {steps}", *options])))
    return runs


def test_a_plan_is_read_whole(tmp_path):
    text = PLAN + '[[entry]]\nname = "semantic"\n'
    plan = read_plan(write_plan(tmp_path, text), ["loop.ema_decay = 0.5"], None)
    names = ["shipped", "thin one", "big", "filling", "semantic"]
    assert [entry.name for entry in plan.entries] == names
    assert plan.entries[1].folder == "thin-one"
    recipes = [None, "comparison-depth", None, None, "comparison-semantics"]
    assert [entry.recipe for entry in plan.entries] == recipes
    recipe = recipe_of(plan.entries[1], plan)
    assert recipe.model.name == "sparse-conv"
    assert recipe.data.batch_size == 2
    assert recipe.loop.ema_decay == 0.5
    only = read_plan(write_plan(tmp_path, text), [], ["filling"])
    assert [entry.name for entry in only.entries] == ["filling"]


@pytest.mark.parametrize(
    ("change", "only", "message"),
    [
        (("set =", "sets ="), None, "unknown key sets"),
        (("onnx =", "onyx ="), None, "unknown key onyx"),
        (('recipe = "comparison-semantics"', ""), ["semantic"], "recipe to train 'semantic' by"),
        (("big", "thin:one"), None, "two entries are called 'thin-one'"),
        (("", ""), ["thin"], "--only 'thin': no such entry; known: shipped, thin one, big"),
        (("recipe =", "recipe"), None, "cannot be read"),
    ],
)
def test_a_bad_plan_is_refused(tmp_path, change, only, message):
    text = PLAN.replace(*change, 1) + '[[entry]]\nname = "semantic"\n'
    with pytest.raises(InputError, match=message):
        read_plan(write_plan(tmp_path, text), [], only)


def test_the_queue_trains_scores_times_and_prints(
    data, plan_file, export_nano, monkeypatch, capsys, small_model, bench_in_threads
):
    runs = run("train", plan_file, "--data", data, "--limit", 1)
    assert export_nano == [runs / "thin-one" / "model.pt"]
    # No simulated line meets a scene as small as this: its frames are scored without LiDAR.
    scored = {"streets 64", "streets 16", "rendered none"}
    for name in ("thin-one", "filling"):
        assert json.loads((runs / name / "scores.json").read_text())["figures"].keys() == scored
    assert not (runs / "big").exists()

    monkeypatch.setattr(comparison, "export_graph", lambda graph: small_model())
    monkeypatch.setattr(comparison, "SIZES", [(64, 96)])
    run("time", plan_file, "--rounds", 1)
    capsys.readouterr()
    run("table", plan_file)
    lines = capsys.readouterr().out.splitlines()
    semantics, depth = (
        lines.index(f"**{title}**") for title in ("Semantics", "Depth completion, MAE / RMSE in mm")
    )
    shipped = lines[semantics + 4].split(" | ")
    assert shipped[:2] == ["| shipped", "as it ships"]
    assert 0 <= float(shipped[2]) <= 100
    assert shipped[3] == "51"
    assert float(shipped[4]) == pytest.approx(1.09, abs=0.01)
    assert all(float(cell.rstrip(" |")) > 0 for cell in shipped[5:])
    rows = {line.split(" | ")[0]: line.split(" | ") for line in lines[depth:]}
    _, samples, first, second, stream, rendered, *_ = rows["| thin one"]
    assert samples == "4 samples"
    assert all(" / " in cell for cell in (first, second))
    assert stream == rendered == ""
    assert rows["| big"][1:6] == ["not trained here", "", "", "", ""]
    assert float(rows["| big"][6]) > 0
    assert rows["| filling"][1] == "no training"
    assert rows["| filling"][6:8] == ["", ""]
    assert float(rows["| filling"][8].rstrip(" |")) >= 0


def test_a_finished_entry_is_kept_and_a_failure_does_not_stop_the_rest(
    data, plan_file, export_nano, monkeypatch, capsys
):
    """A finished training is used again, and exported again when its weights change."""
    only = ("--data", data, "--limit", 1, "--only", "thin one", "filling")
    trainings = []

    def train(recipe, *, data, out, device, stop):
        trainings.append(out)
        out.mkdir(parents=True)
        text = comparison.json.dumps({"recipe": comparison.asdict(recipe)}, default=str)
        (out / "recipe.json").write_text(text)
        (out / "model.pt").write_bytes(b"weights")

    digests = {"sha": ""}

    def load(path):
        contract = SimpleNamespace(checkpoint_sha256=digests["sha"])
        return SimpleNamespace(contract=contract, sha256="of the file")

    monkeypatch.setattr(comparison, "train", train)
    monkeypatch.setattr(comparison, "load_model_file", load)
    runs = run("train", plan_file, *only)
    digests["sha"] = hashlib.sha256(b"weights").hexdigest()
    run("train", plan_file, *only)
    assert trainings == [runs / "thin-one"]
    assert len(export_nano) == 1
    (runs / "thin-one" / "model.pt").write_bytes(b"other weights")
    run("train", plan_file, *only)
    assert len(export_nano) == 2
    capsys.readouterr()
    with pytest.raises(SystemExit, match="1 left out: thin one"):
        run("train", plan_file, *only, steps=3)
    out = capsys.readouterr().out
    assert "thin one: left out" in out
    assert "steps was 2, now it is 3" in out
    assert "filling {" in out


def test_scores_are_kept_until_the_model_the_sets_or_the_limit_change(tmp_path, monkeypatch):
    calls = []

    def evaluate(models, data, *, lidars, **_):
        calls.append(tuple(models))
        return [SimpleNamespace(lidar=str(lidar), figures={"miou": 0.5}) for lidar in lidars]

    monkeypatch.setattr(comparison, "evaluate", evaluate)
    content = {"sha256": "one"}
    monkeypatch.setattr(comparison, "load_model_file", lambda _: SimpleNamespace(**content))
    sets = {"camvid": (comparison.CamVidRecipe(path="x", split="val"), ["none", "64"])}
    arguments = SimpleNamespace(threads=1, limit=None)

    def score(onnx="model.onnx", method=None):
        return comparison.find_or_score(tmp_path / "run", sets, arguments, onnx, method)

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


def test_a_stopped_queue_exits_as_interrupted(data, plan_file, monkeypatch):
    def train(recipe, *, data, out, device, stop):
        signal.raise_signal(signal.SIGTERM)
        assert stop()

    monkeypatch.setattr(comparison, "train", train)
    with pytest.raises(SystemExit) as stopped:
        run("train", plan_file, "--data", data, "--only", "thin one", "filling")
    assert stopped.value.code == comparison.INTERRUPTED
    assert not (plan_file.parent / "runs" / "filling").exists()


def test_bad_names_are_refused_before_anything_is_trained(data, tmp_path):
    for change, message in (
        (("nearest", "furthest"), "furthest"),
        (('network = "sparse', 'network = "dense'), "no network 'dense-conv'; known: .*enet"),
        (('name = "sparse-conv"', 'name = "sparse"'), "sparse"),
    ):
        path = write_plan(tmp_path, PLAN.replace(*change))
        with pytest.raises(SystemExit, match=message):
            run("train", path, "--data", data)
    assert not (tmp_path / "runs").exists()
    with pytest.raises(InputError, match="is none of camvid: nothing to score on"):
        comparison.find_sets(("semantic",), [tmp_path])


def test_the_plan_that_ships_trains_all_of_a_task_alike():
    path = comparison.Path(comparison.__file__).with_suffix(".toml")
    plan = read_plan(path, [], None)
    named = {entry.network for entry in plan.entries}
    budgets = {}
    for entry in plan.entries:
        comparison.heads_of(entry, plan)
        if entry.is_trained:
            recipe = recipe_of(entry, plan)
            named.add(recipe.model.name)
            budgets.setdefault(entry.recipe, set()).add(
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


def test_an_entry_is_trained_unless_it_says_otherwise():
    assert Entry(name="a").is_trained
    for kind in ("onnx", "network", "method"):
        assert not Entry(name="a", **{kind: "x"}).is_trained
