"""The rate over the steps and the average, by hand."""

import math

import pytest
import torch

from training.optimizer import exponential_average, learning_rate
from training.recipe import ScheduleRecipe


def test_learning_rate_by_hand():
    schedule = ScheduleRecipe(steps=110, warmup_steps=10, final_ratio=0.1)
    assert learning_rate(schedule, 1.0, 0) == pytest.approx(0.1)
    assert learning_rate(schedule, 1.0, 9) == pytest.approx(1.0)
    assert learning_rate(schedule, 1.0, 60) == pytest.approx(0.1 + 0.9 * 0.5)
    assert learning_rate(schedule, 1.0, 110) == pytest.approx(0.1)
    constant = ScheduleRecipe(steps=110, shape="constant")
    assert {learning_rate(constant, 0.3, step) for step in range(110)} == {0.3}
    assert math.isclose(learning_rate(schedule, 2.0, 35), 2 * (0.1 + 0.9 * 0.853553), rel_tol=1e-5)


def test_average_forgets_its_start():
    """After n steps at a constant value nothing of a far-off start is left."""
    update = exponential_average(0.999)
    average, current = [torch.full((3,), 1000.0)], [torch.ones(3)]
    for count in range(200):
        update(average, current, count)
    torch.testing.assert_close(average[0], current[0], rtol=0, atol=1e-3)
    long_run = [torch.zeros(1)]
    update(long_run, [torch.ones(1)], 10**6)
    torch.testing.assert_close(long_run[0], torch.tensor([1e-3]))
