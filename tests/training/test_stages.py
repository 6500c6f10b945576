"""Recipes of several stages: each begins with the weights of the one before, wherever one stops."""

import os
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from models import SSDNetLite, SSDNetLiteConfig, load_checkpoint
from models.registry import NETWORKS, Entry
from runtime.errors import InputError
from training import cli, stages
from training.recipe import read_recipe
from training.stages import read_stages, train_stages

TINY = SSDNetLiteConfig(
    encoder_widths=(8,) * 16,
    decoder_channels=(8, 8, 8),
)
RECIPE = """
terms = "none"
[model]
name = "ssdnet-lite"
[data]
batch_size = 2
workers = 0
seed = 3
[data.augment]
crop = [32, 32]
[[data.source]]
kind = "camvid"
path = "camvid"
[schedule]
steps = 3
[optimizer]
learning_rate = 2e-3
encoder_rate = 1e-3
[loop]
checkpoint_every = 1
[[stage]]
name = "all"
[[stage]]
name = "depth"
[stage.schedule]
steps = 2
[stage.optimizer]
frozen = ["encoder."]
[stage.data]
seed = 4
"""


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


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE)
    return path


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
def test_model_pt_is_written_when_the_last_stage_is_finished(
    path, data, tmp_path, stop_after, expected
):
    out = tmp_path / "run"
    result = train_stages(read_stages(path), data=[data], out=out, stop_after=stop_after)
    assert result == out / expected
    assert result.is_file()
    assert (out / "model.pt").exists() == (expected == "model.pt")
    assert (out / "2-depth").exists() == (stop_after > 3)


@pytest.mark.slow
def test_several_processes_run_all_stages_in_one_group(path, data, tmp_path):
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    command += ["-m", "training", str(path)]
    command += ["--data", str(data), "--out", str(tmp_path / "run")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, env=environment)
    assert done.returncode == 0, done.stderr
    first, last = (tmp_path / "run" / name for name in ("model.pt", "2-depth/model.pt"))
    assert first.read_bytes() == last.read_bytes()
    assert done.stdout.split() == [str(tmp_path / "run/model.pt")] * 2


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


def test_each_stage_begins_with_the_weights_of_the_one_before(path, data, tmp_path):
    first, second = read_stages(path)
    assert (first.folder, first.recipe.schedule.steps) == ("1-all", 3)
    assert (second.folder, second.recipe.schedule.steps) == ("2-depth", 2)
    assert second.recipe.data.batch_size == 2
    out = tmp_path / "run"
    assert train_stages((first, second), data=[data], out=out) == out / "model.pt"
    assert (out / "model.pt").read_bytes() == (out / "2-depth" / "model.pt").read_bytes()
    before, after = weights(out / "1-all" / "model.pt"), weights(out / "model.pt")
    frozen = {name for name in before if name.startswith("encoder.")}
    assert all(torch.equal(before[name], after[name]) for name in frozen)
    assert not torch.equal(before["semantic_head.weight"], after["semantic_head.weight"])
    assert load_checkpoint(out / "model.pt").training["init"].startswith("model.pt (sha256 ")
    rates = load_checkpoint(out / "1-all" / "last.pt").trainer["optimizer"]["param_groups"]
    assert [group["lr"] / rates[0]["lr"] for group in rates] == [1, 1, 0.5, 0.5]  # one schedule


def test_a_stage_changes_what_an_earlier_one_changed(path):
    path.write_text(
        RECIPE
        + """
[[stage]]
name = "longer"
base = "depth"
schedule.steps = 7
data.batch_size = 1
[[stage]]
name = "slower"
base = "longer"
optimizer.learning_rate = 1e-4
"""
    )
    first, second, third, last = (stage.recipe for stage in read_stages(path))
    changed = {"frozen": ("encoder.",), "learning_rate": 1e-4}
    assert third == replace(
        second, schedule=replace(second.schedule, steps=7), data=replace(second.data, batch_size=1)
    )
    assert last == replace(third, optimizer=replace(third.optimizer, **changed))
    assert first.optimizer.frozen == ()


def test_killed_at_any_step_it_resumes_to_the_same_weights(path, data, tmp_path, monkeypatch):
    wanted = read_stages(path)
    train_stages(wanted, data=[data], out=tmp_path / "whole")
    out = tmp_path / "killed"
    for calls in (1, 2, 2, 2, 2):  # before each step
        with pytest.raises(Killed):
            train_stages(wanted, data=[data], out=out, stop=killer(calls))
        assert not (out / "model.pt").exists()

    def killed(*_):
        raise Killed

    with monkeypatch.context() as patch:  # before the last file is written
        patch.setattr(stages, "atomic_write", killed)
        with pytest.raises(Killed):
            train_stages(wanted, data=[data], out=out)
    assert train_stages(wanted, data=[data], out=out) == out / "model.pt"
    assert_same(out / "model.pt", tmp_path / "whole" / "model.pt")


def test_killed_between_two_stages_it_goes_on_with_the_next(path, data, tmp_path, monkeypatch):
    wanted, out = read_stages(path), tmp_path / "run"
    with monkeypatch.context() as patch:
        train = stages.train

        def killed_before_the_second(recipe, **options):
            if options["init"] is not None:
                raise Killed
            return train(recipe, **options)

        patch.setattr(stages, "train", killed_before_the_second)
        with pytest.raises(Killed):
            train_stages(wanted, data=[data], out=out)
    assert sorted(path.name for path in out.iterdir()) == ["1-all"]
    first = (out / "1-all" / "model.pt").stat().st_mtime_ns
    train_stages(wanted, data=[data], out=out)
    assert (out / "1-all" / "model.pt").stat().st_mtime_ns == first
    train_stages(wanted, data=[data], out=tmp_path / "whole")
    assert_same(out / "model.pt", tmp_path / "whole" / "model.pt")


def test_a_finished_stage_of_another_recipe_is_refused_by_its_name(path, data, tmp_path):
    out = tmp_path / "run"
    train_stages(read_stages(path), data=[data], out=out)
    path.write_text(RECIPE.replace('name = "all"', 'name = "all"\nschedule.steps = 4'))
    with pytest.raises(InputError, match=r"1-all.*schedule\.steps was 3, now it is 4"):
        train_stages(read_stages(path), data=[data], out=out)
    path.write_text(RECIPE.replace('name = "all"', 'name = "other"'))
    with pytest.raises(InputError, match=r"holds 1-all, but the stages of this recipe are 1-other"):
        train_stages(read_stages(path), data=[data], out=out)
    path.write_text(RECIPE.split("[[stage]]")[0])
    with pytest.raises(InputError, match="holds 1-all"):
        train_stages(read_stages(path), data=[data], out=out)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('name = "depth"', 'name = "all"', r"stage\[1\]\.name = 'all': another stage has this"),
        ('name = "depth"', "", r"stage\[1\]\.name = None; expected small letters"),
        ('name = "depth"', 'name = "a/b"', r"stage\[1\]\.name = 'a/b'; expected small letters"),
        (
            'name = "all"',
            'name = "all"\nbase = "depth"',
            r"stage\[0\]\.base = 'depth'; expected the name of an earlier stage: there is none",
        ),
        (
            'name = "depth"',
            'name = "depth"\nbase = "al"',
            r"stage\[1\]\.base = 'al'; expected the name of an earlier stage: all\.",
        ),
        ('name = "depth"', 'name = "depth"\nbase = 1', r"stage\[1\]\.base = 1; expected"),
        ("frozen = ", "frozn = ", "unknown key optimizer.frozn"),
        ("[stage.schedule]", "[stage.stage]", "unknown key stage"),
    ],
)
def test_invalid_stages_are_refused(path, old, new, text):
    path.write_text(RECIPE.replace(old, new))
    with pytest.raises(InputError, match=f"recipe.toml: {text}"):
        read_stages(path)


def test_a_recipe_with_stages_is_no_single_run(path):
    with pytest.raises(InputError, match="has stages, which only ssdnet-train runs"):
        read_recipe(path)


def test_the_command_stops_at_a_step_over_all_stages_and_changes_all(path, data, tmp_path):
    out = tmp_path / "run"
    arguments = [str(path), "--data", str(data), "--out", str(out), "--set", "data.batch_size = 3"]

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
