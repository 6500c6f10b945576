"""Ctrl-C saves and stops, with workers that do not inherit memory, as on Linux from 3.14."""

import os
import signal
import sys

import pytest

from layouts import kitti_stream
from models import load_checkpoint

pytestmark = pytest.mark.slow

TRAIN = """
import multiprocessing, os, sys
if __name__ == "__main__":
    multiprocessing.set_start_method("spawn")
    import torch
    torch.set_num_threads(1)
    from training.losses import SSDNetLoss
    forward = SSDNetLoss.forward
    def compute_loss(*arguments):
        os.write(1, b"batch\\n")
        return forward(*arguments)
    SSDNetLoss.forward = compute_loss
    from training.__main__ import train
    train()
"""

RECIPE = """
[model]
name = "ssdnet-small"
[data]
batch_size = 2
workers = 1
augment.crop = [32, 32]
cache_gib = 0.1
[[data.source]]
kind = "kitti-stream"
path = "stream"
[schedule]
steps = 100000
[loop]
checkpoint_every = 100000
log_every = 100000
accumulate = 8
"""


def test_a_run_with_spawned_workers_trains_and_stops(tmp_path, start_process):
    kitti_stream.write_stream(tmp_path / "stream", magnify=5)
    (tmp_path / "r.toml").write_text(RECIPE)
    (tmp_path / "spawned.py").write_text(TRAIN)
    out = tmp_path / "run"
    arguments = [str(tmp_path / "r.toml"), "--data", str(tmp_path), "--out", str(out)]
    process = start_process(sys.executable, "-W", "ignore", tmp_path / "spawned.py", *arguments)
    lines = [process.stdout.readline() for _ in range(3)]
    if lines[-1]:
        os.killpg(process.pid, signal.SIGINT)  # the worker gets it, too
    output, errors = process.communicate(timeout=180)
    assert process.returncode == 130, errors[-3000:]
    assert "Traceback" not in errors
    assert f"stopped; the same command resumes from {out / 'last.pt'}" in errors
    assert not (out / "model.pt").exists()
    # The worker went on to the end of the step, beyond what it had prepared.
    assert 3 + output.count("batch\n") == 8
    assert load_checkpoint(out / "last.pt").trainer["step"] == 1
