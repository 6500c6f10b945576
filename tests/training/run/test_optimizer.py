"""The rate over the steps and the average, by hand."""

import math

import pytest
import torch

from models import create_model
from runtime.base.errors import InputError
from training.losses import LossConfig, SSDNetLoss
from training.run.optimizer import OptimizerRecipe, ScheduleRecipe, build_optimizer, learning_rate
from training.run.state import exponential_average


def loss(config):
    return SSDNetLoss(config, None, max_depth_m=100.0, unmeasured_range_m=100.0, road=None)


@pytest.mark.parametrize("name", ["adamw", "sgd"])
def test_weight_decay_pulls_at_kernels_alone(name):
    """A step without any gradient: what is decayed shrinks, all else stays."""
    network = create_model("ssdnet-small")
    criterion = loss(LossConfig(weighting="uncertainty"))
    parameters = dict([*network.named_parameters(), *criterion.named_parameters()])
    with torch.no_grad():
        for value in parameters.values():
            value.fill_(1.0)
            value.grad = torch.zeros_like(value)
    recipe = OptimizerRecipe(name=name, learning_rate=0.1, weight_decay=0.5)
    build_optimizer(recipe, network, criterion).step()
    kinds = {"conv": 0, "bias": 0, "norm": 0, "learned by the loss": 0}
    for key, value in parameters.items():
        decayed = value.ndim == 4
        torch.testing.assert_close(value, torch.full_like(value, 0.95 if decayed else 1.0), msg=key)
        kinds["conv"] += decayed
        kinds["bias"] += key.endswith("bias")
        kinds["norm"] += not decayed and key.endswith("weight")
        kinds["learned by the loss"] += key.startswith("log_variances")
    assert all(kinds.values()), kinds


def test_the_encoder_has_a_rate_of_its_own():
    network, criterion = create_model("ssdnet-nano"), loss(LossConfig())
    recipe = OptimizerRecipe(learning_rate=2e-3, encoder_rate=4e-4, weight_decay=0.1)
    groups = build_optimizer(recipe, network, criterion).param_groups
    rates = {p: (g["lr"], g["weight_decay"]) for g in groups for p in g["params"]}
    assert rates.keys() == set(network.parameters())
    assert rates[network.encoder.stem[0][0].weight] == (4e-4, 0.1)
    assert rates[network.encoder.stem[0][1].weight] == (4e-4, 0.0)
    assert rates[network.semantic_head.weight] == (2e-3, 0.1)
    assert rates[network.semantic_head.bias] == (2e-3, 0.0)
    with pytest.raises(InputError, match="'enet' has no part called 'encoder'"):
        build_optimizer(recipe, create_model("enet"), criterion)


def test_fixed_statistics_are_kept_while_weights_learn():
    network = create_model("ssdnet-nano")
    recipe = OptimizerRecipe(frozen=("encoder",), fixed_statistics=True)
    build_optimizer(recipe, network, loss(LossConfig()))
    norm = network.depth_decoder.blocks[0].norm
    network(torch.rand(1, 3, 32, 32), torch.zeros(1, 1, 32, 32)).depths[0].sum().backward()
    assert not norm.running_mean.any()
    assert norm.weight.grad is not None


def test_learning_rate_by_hand():
    schedule = ScheduleRecipe(steps=110, warmup_steps=10)
    assert learning_rate(schedule, 1.0, 0) == pytest.approx(0.1)
    assert learning_rate(schedule, 1.0, 9) == pytest.approx(1.0)
    assert learning_rate(schedule, 1.0, 60) == pytest.approx(0.5)
    assert learning_rate(schedule, 1.0, 110) == pytest.approx(0)
    constant = ScheduleRecipe(steps=110, shape="constant")
    assert {learning_rate(constant, 0.3, step) for step in range(110)} == {0.3}
    assert math.isclose(learning_rate(schedule, 2.0, 35), 2 * 0.853553, rel_tol=1e-5)


@pytest.mark.parametrize(("keeps_start", "decays"), [(False, (0.1, 0.5, 0.9)), (True, (0.9,) * 3)])
def test_the_average_forgets_the_first_weights_of_a_short_run(keeps_start, decays):
    """The decay grows from 1/10 as (1 + n) / (10 + n) to its value; counters are copied."""
    update = exponential_average(0.9, keeps_start=keeps_start)
    for count, decay in zip((0, 8, 1000), decays, strict=True):
        average, counter = [torch.tensor([1.0, 2.0])], [torch.tensor(3)]
        update(average, [torch.tensor([2.0, 4.0])], count)
        update(counter, [torch.tensor(7)], count)
        torch.testing.assert_close(
            average[0], torch.tensor([2.0, 4.0]) - decay * torch.tensor([1.0, 2.0])
        )
        assert counter[0] == 7
