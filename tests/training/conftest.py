"""Trainings in tests run on one thread: two workers with two threads each wait for one another."""

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def one_thread():
    """Take back what a command or an opened checkpoint has set."""
    yield
    torch.set_num_threads(1)
