"""Recipes of several stages: each begins with the weights of the one before, wherever one stops."""

from dataclasses import replace

import pytest
import torch
from typer.testing import CliRunner

from models import create_model, load_checkpoint
from runtime.base.errors import InputError
from training.commands.train import app
from training.datasets.camvid import CamVidRecipe
from training.loading.augment_config import AugmentConfig
from training.loading.data_recipe import DataRecipe
from training.recipes.registry import RECIPES, PackageRecipe
from training.run.network import ModelRecipe
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe
from training.run.recipe import LoopRecipe, Recipe, derive
from training.run.stages import Stage, train_stages
from training.run.training_run import TrainingRun
from training.weights.prune import prune_trunk
from training.weights.release import add_offsets, mix_weights

pytestmark = pytest.mark.usefixtures("tiny_lite")

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
    schedule=ScheduleRecipe(steps=2),
    optimizer=OptimizerRecipe(encoder_rate=1e-3),
    loop=LoopRecipe(checkpoint_every=1),
)
DEPTH = derive(ALL, schedule={"steps": 2}, optimizer={"frozen": ("encoder.",)}, data={"seed": 4})
STAGES = (Stage("1-all", ALL), Stage("2-depth", DEPTH))


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


def test_killed_at_any_step_each_stage_begins_with_the_weights_of_the_one_before(data, tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "killed"
    assert train_stages(STAGES, TrainingRun([data], whole)).path == whole / "model.pt"
    for calls in (1, 2, 2, 2):  # before each step
        with pytest.raises(Killed):
            train_stages(STAGES, TrainingRun([data], out, stop=killer(calls)))
        assert not (out / "model.pt").exists()
    assert train_stages(STAGES, TrainingRun([data], out)).path == out / "model.pt"
    assert (out / "model.pt").read_bytes() == (out / "2-depth" / "model.pt").read_bytes()
    before, after, expected = (weights(path / "model.pt") for path in (out / "1-all", out, whole))
    assert all(torch.equal(value, expected[name]) for name, value in after.items())
    assert all(torch.equal(before[key], after[key]) for key in before if key.startswith("encoder."))
    assert not torch.equal(before["semantic_head.weight"], after["semantic_head.weight"])
    assert load_checkpoint(out / "model.pt").training["init"].startswith("model.pt (sha256 ")
    rates = load_checkpoint(out / "1-all" / "last.pt").trainer["optimizer"]["param_groups"]
    assert [group["lr"] / rates[0]["lr"] for group in rates] == [1, 1, 0.5, 0.5]  # one schedule
    # A finished stage of another recipe is refused by its name.
    longer = derive(ALL, schedule={"steps": 3})
    for stages, text in (
        ((Stage("1-all", longer), STAGES[1]), r"1-all.*schedule\.steps was 2, now it is 3"),
        ((Stage("1-other", ALL), STAGES[1]), "holds 1-all, but .* are 1-other"),
        ((Stage("", ALL),), "holds 1-all"),
    ):
        with pytest.raises(InputError, match=text):
            train_stages(stages, TrainingRun([data], out))


NARROW_WIDTHS = [8] * 15 + [4]
ONE_STEP = derive(ALL, schedule={"steps": 1})
NARROW = derive(DEPTH, schedule={"steps": 1}, model={"config": {"encoder_widths": NARROW_WIDTHS}})
CALLED = (
    Stage(
        "1-all",
        ONE_STEP,
        then=lambda network, pictures: prune_trunk(network, NARROW_WIDTHS, pictures),
    ),
    Stage("2-narrow", NARROW),
    Stage(
        "3-again",
        replace(NARROW, data=ALL.data),
        then=lambda network, _: add_offsets(network, {"road": 2.0}),
    ),
)


def test_a_call_makes_what_the_next_stage_begins_with_and_what_is_released(
    data, tmp_path, tiny_lite
):
    """This also holds if the run is killed in a call."""

    def killed(network, pictures):
        raise Killed

    out = tmp_path / "run"
    for index in (0, 2):
        stages = [replace(item, then=killed) if item is CALLED[index] else item for item in CALLED]
        with pytest.raises(Killed):
            train_stages(stages, TrainingRun([data], out))
        assert not (out / CALLED[index].folder / "result.pt").exists()
    assert not (out / "model.pt").exists()
    assert train_stages(CALLED, TrainingRun([data], out)).path == out / "model.pt"
    wide, pruned, narrow, last = (
        weights(out / name)
        for name in ("1-all/model.pt", "1-all/result.pt", "2-narrow/model.pt", "3-again/model.pt")
    )
    key = "encoder.stride32.4.expand.0.weight"
    assert (len(wide[key]), len(pruned[key])) == (8, 4)
    assert torch.equal(pruned[key], narrow[key])  # frozen
    assert load_checkpoint(out / "2-narrow/model.pt").training["init"].startswith("result.pt (sha")
    last["semantic_head.bias"][[info.name for info in tiny_lite.classes].index("road")] += 2.0
    torch.testing.assert_close(weights(out / "model.pt"), last)
    facts = [load_checkpoint(out / name).training for name in ("model.pt", "3-again/model.pt")]
    assert facts[0] == facts[1]


def test_mixed_weights_lie_between_those_of_two_networks():
    before, after = (create_model("ssdnet-lite") for _ in range(2))
    for network, counted in ((before, 3), (after, 5)):
        for value in network.buffers():
            if not value.is_floating_point():
                value.fill_(counted)
    old, new = before.state_dict(), after.state_dict()
    for name, value in mix_weights(before, after, 0.25).state_dict().items():
        expected = 0.75 * old[name] + 0.25 * new[name] if value.is_floating_point() else new[name]
        torch.testing.assert_close(value, expected)
    after.config = replace(after.config, canonical_focal_px=500.0)
    with pytest.raises(InputError, match="not of one network"):
        mix_weights(before, after, 0.25)


def test_a_run_of_one_stage_releases_what_its_call_makes(data, tmp_path):
    """Without an average the released weights are those of the last step."""
    recipe = derive(ALL, loop={"ema_decay": 0.0})
    stage = Stage("", recipe, then=lambda network, _: add_offsets(network, {"road": 2.0}))
    for _ in range(2):  # the finished run is not changed again
        path = train_stages((stage,), TrainingRun([data], tmp_path / "run")).path
        assert path == tmp_path / "run" / "model.pt"
    before, after = (
        weights(each)["semantic_head.bias"] for each in (path.with_name("last.pt"), path)
    )
    road = [info.name for info in load_checkpoint(path).model.config.classes].index("road")
    assert (after - before)[road] == pytest.approx(2.0)
    assert (after - before).abs().sum() == pytest.approx(2.0)


def test_the_command_stops_at_a_step_over_all_stages_and_changes_all(data, tmp_path, monkeypatch):
    monkeypatch.setitem(RECIPES, "two", PackageRecipe("Two stages.", STAGES))
    out = tmp_path / "run"
    arguments = ["two", "--data", str(data), "--out", str(out), "--set", "data.batch_size = 3"]

    def run(*options):
        result = CliRunner().invoke(app, [*arguments, *options])
        assert result.exit_code == 0, result.output
        return result.stdout.splitlines()[-1].removeprefix(f"{out}/")

    assert run("--stop-after", "2") == "1-all/model.pt"
    assert not (out / "2-depth").exists()
    assert run("--dry-run") == "2-depth/batch.png"
    assert run("--stop-after", "3") == "2-depth/last.pt"
    assert load_checkpoint(out / "2-depth" / "last.pt").trainer["step"] == 1
    assert not (out / "model.pt").exists()
    assert run() == "model.pt"
    assert load_checkpoint(out / "model.pt").training["recipe"]["data"]["batch_size"] == 3
