"""Recipes of several stages: each begins with the weights of the one before, wherever one stops."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from models import SSDNetLite, SSDNetLiteConfig, load_checkpoint
from models.registry import NETWORKS, Entry
from runtime.errors import InputError
from training import cli
from training.datasets.camvid import CamVidRecipe
from training.loading.augment import AugmentConfig
from training.prune import prune_trunk
from training.recipe import (
    DataRecipe,
    LoopRecipe,
    ModelRecipe,
    OptimizerRecipe,
    Recipe,
    ScheduleRecipe,
)
from training.recipes.registry import RECIPES, PackageRecipe
from training.release import add_offsets, mix_weights
from training.stages import Stage, train_stages

TINY = SSDNetLiteConfig(
    encoder_widths=(8,) * 16,
    decoder_channels=(8, 8, 8),
)
ALL = Recipe(
    terms="none",
    model=ModelRecipe("ssdnet-lite"),
    data=DataRecipe(
        (CamVidRecipe(path="camvid"),),
        augment=AugmentConfig(crop=(32, 32)),
        batch_size=2,
        workers=0,
        seed=3,
    ),
    schedule=ScheduleRecipe(steps=3),
    optimizer=OptimizerRecipe(encoder_rate=1e-3),
    loop=LoopRecipe(checkpoint_every=1),
)
DEPTH = replace(
    ALL,
    schedule=ScheduleRecipe(steps=2),
    optimizer=replace(ALL.optimizer, frozen=("encoder.",)),
    data=replace(ALL.data, seed=4),
)
STAGES = (Stage("1-all", ALL), Stage("2-depth", DEPTH))


@pytest.fixture(autouse=True)
def tiny_model(monkeypatch):
    monkeypatch.setitem(NETWORKS, "ssdnet-lite", Entry(SSDNetLite, TINY))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    root, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    for folder, shape, top in (("train", (40, 48, 3), 255), ("trainannot", (40, 48), 11)):
        (root / "camvid" / folder).mkdir(parents=True)
        for index in range(4):
            image = rng.integers(0, top, shape, dtype=np.uint8)
            cv2.imwrite(str(root / "camvid" / folder / f"{index}.png"), image)
    return root


@pytest.mark.parametrize(
    ("stop_after", "expected"),
    [
        (2, "1-all/last.pt"),
        (3, "1-all/model.pt"),
        (4, "2-depth/last.pt"),
        (5, "model.pt"),
        (6, "model.pt"),
    ],
)
def test_model_pt_is_written_when_the_last_stage_is_finished(data, tmp_path, stop_after, expected):
    out = tmp_path / "run"
    result = train_stages(STAGES, data=[data], out=out, stop_after=stop_after)
    assert result == out / expected
    assert result.is_file()
    assert (out / "model.pt").exists() == (expected == "model.pt")
    assert (out / "2-depth").exists() == (stop_after > 3)


@pytest.mark.slow
def test_several_processes_run_all_stages_in_one_group(data, tmp_path):
    script = tmp_path / "train.py"
    script.write_text(
        "import sys\nfrom pathlib import Path\nfrom test_stages import STAGES, train_stages\n"
        "print(train_stages(STAGES, data=[Path(sys.argv[1])], out=Path(sys.argv[2])))\n"
    )
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    command += [str(script), str(data), str(tmp_path / "run")]
    folders = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""), os.getcwd()]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(folders)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, env=environment)
    assert done.returncode == 0, done.stderr
    first, last = (tmp_path / "run" / name for name in ("model.pt", "2-depth/model.pt"))
    assert first.read_bytes() == last.read_bytes()
    assert done.stdout.count(str(tmp_path / "run/model.pt")) == 2


class Killed(BaseException):
    """Ends a run as SIGKILL does: nothing is written any more."""


def killer(calls):
    """A `stop` that kills the run the so-many-th time that the loop asks."""
    left = iter(range(calls - 1))

    def stop():
        if next(left, None) is None:
            raise Killed
        return False

    return stop


def weights(path):
    return load_checkpoint(path).model.state_dict()


def assert_same(first, second):
    expected = weights(second)
    for name, value in weights(first).items():
        assert torch.equal(value, expected[name]), name


def test_each_stage_begins_with_the_weights_of_the_one_before(data, tmp_path):
    out = tmp_path / "run"
    assert train_stages(STAGES, data=[data], out=out) == out / "model.pt"
    assert (out / "model.pt").read_bytes() == (out / "2-depth" / "model.pt").read_bytes()
    before, after = weights(out / "1-all" / "model.pt"), weights(out / "model.pt")
    frozen = {name for name in before if name.startswith("encoder.")}
    assert all(torch.equal(before[name], after[name]) for name in frozen)
    assert not torch.equal(before["semantic_head.weight"], after["semantic_head.weight"])
    assert load_checkpoint(out / "model.pt").training["init"].startswith("model.pt (sha256 ")
    rates = load_checkpoint(out / "1-all" / "last.pt").trainer["optimizer"]["param_groups"]
    assert [group["lr"] / rates[0]["lr"] for group in rates] == [1, 1, 0.5, 0.5]  # one schedule


NARROW_WIDTHS = [8] * 15 + [4]
NARROW = replace(DEPTH, model=replace(DEPTH.model, config={"encoder_widths": NARROW_WIDTHS}))
CALLED = (
    Stage("1-all", ALL, then=lambda run: prune_trunk(run.after, NARROW_WIDTHS, run.pictures)),
    Stage("2-narrow", NARROW),
    Stage(
        "3-mixed",
        replace(NARROW, data=ALL.data),
        then=lambda run: add_offsets(mix_weights(run.before, run.after, 0.25), {"road": 2.0}),
    ),
)


def test_a_call_makes_what_the_next_stage_begins_with_and_what_is_released(data, tmp_path):
    """Also where the run is killed in a call."""

    def killed(run):
        raise Killed

    out = tmp_path / "run"
    for index in (0, 2):
        stages = [replace(item, then=killed) if item is CALLED[index] else item for item in CALLED]
        with pytest.raises(Killed):
            train_stages(stages, data=[data], out=out)
        assert not (out / CALLED[index].folder / "result.pt").exists()
    assert not (out / "model.pt").exists()
    assert train_stages(CALLED, data=[data], out=out) == out / "model.pt"
    wide, pruned, narrow, last = (
        weights(out / name)
        for name in ("1-all/model.pt", "1-all/result.pt", "2-narrow/model.pt", "3-mixed/model.pt")
    )
    key = "encoder.stride32.4.expand.0.weight"
    assert (len(wide[key]), len(pruned[key])) == (8, 4)
    assert torch.equal(pruned[key], narrow[key])  # frozen
    assert load_checkpoint(out / "2-narrow/model.pt").training["init"].startswith("result.pt (sha")
    for name, value in weights(out / "model.pt").items():
        if value.is_floating_point():
            expected = 0.75 * narrow[name] + 0.25 * last[name]
            if name == "semantic_head.bias":
                expected[[info.name for info in TINY.classes].index("road")] += 2.0
            torch.testing.assert_close(value, expected)
    facts = [load_checkpoint(out / name).training for name in ("model.pt", "3-mixed/model.pt")]
    assert facts[0] == facts[1]


def test_killed_at_any_step_it_resumes_to_the_same_weights(data, tmp_path):
    train_stages(STAGES, data=[data], out=tmp_path / "whole")
    out = tmp_path / "killed"
    for calls in (1, 2, 2, 2, 2):  # before each step
        with pytest.raises(Killed):
            train_stages(STAGES, data=[data], out=out, stop=killer(calls))
        assert not (out / "model.pt").exists()
    assert train_stages(STAGES, data=[data], out=out) == out / "model.pt"
    assert_same(out / "model.pt", tmp_path / "whole" / "model.pt")


def test_a_finished_stage_of_another_recipe_is_refused_by_its_name(data, tmp_path):
    out = tmp_path / "run"
    train_stages(STAGES, data=[data], out=out)
    longer = replace(ALL, schedule=ScheduleRecipe(steps=4))
    with pytest.raises(InputError, match=r"1-all.*schedule\.steps was 3, now it is 4"):
        train_stages((Stage("1-all", longer), STAGES[1]), data=[data], out=out)
    with pytest.raises(InputError, match=r"holds 1-all, but the stages of this recipe are 1-other"):
        train_stages((Stage("1-other", ALL), STAGES[1]), data=[data], out=out)
    with pytest.raises(InputError, match="holds 1-all"):
        train_stages((Stage("", ALL),), data=[data], out=out)


def test_the_command_stops_at_a_step_over_all_stages_and_changes_all(data, tmp_path, monkeypatch):
    monkeypatch.setitem(RECIPES, "two", PackageRecipe("Two stages.", STAGES))
    out = tmp_path / "run"
    arguments = ["two", "--data", str(data), "--out", str(out), "--set", "data.batch_size = 3"]

    def run(*options):
        result = CliRunner().invoke(cli.app, [*arguments, *options])
        assert result.exit_code == 0, result.output
        return result.stdout.splitlines()[-1]

    assert run("--dry-run") == str(out / "1-all" / "batch.png")
    assert run("--stop-after", "3") == str(out / "1-all" / "model.pt")
    assert not (out / "2-depth").exists()
    assert run("--dry-run") == str(out / "2-depth" / "batch.png")
    assert run("--stop-after", "4") == str(out / "2-depth" / "last.pt")
    assert load_checkpoint(out / "2-depth" / "last.pt").trainer["step"] == 1
    assert run() == str(out / "model.pt")
    assert load_checkpoint(out / "model.pt").training["recipe"]["data"]["batch_size"] == 3
