"""Trainings in tests run on one thread: two workers with two threads each wait for one another."""

import torch

torch.set_num_threads(1)
