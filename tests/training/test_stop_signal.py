"""Ctrl-C and SIGTERM save and stop; the same command resumes."""

import os
import signal
import sys
import time

import numpy as np
import pytest

from layouts import camvid
from models import load_checkpoint
from training.stop_signal import stop_signal

#: ssdnet-train with a small network; says every step, and waits there for a line if told to.
TRAIN = """
import os, sys
import torch
from models import SSDNetLite, SSDNetLiteConfig
from models.registry import NETWORKS, Entry
NETWORKS["ssdnet-lite"] = Entry(SSDNetLite, SSDNetLiteConfig(
    encoder_widths=(8,) * 16, decoder_channels=(8, 8, 8),
))
torch.set_num_threads(1)
rank, wait = os.environ.get("RANK", "0"), os.environ["WAIT"]
def say(text):
    os.write(1, f"{rank} {os.getpid()} {text}\\n".encode())
    if text == wait:
        sys.stdin.readline()
class Imports:
    def find_spec(self, name, *_):
        if name == "training.loop":
            say("importing")
if wait == "importing":
    sys.meta_path.insert(0, Imports())
else:
    from training.losses import SSDNetLoss
    forward = SSDNetLoss.forward
    def compute_loss(*arguments):
        say("step")
        return forward(*arguments)
    SSDNetLoss.forward = compute_loss
from training.__main__ import main
main()
"""

RECIPE = """
[model]
name = "ssdnet-lite"
[data]
batch_size = 2
workers = 1
augment.crop = [32, 32]
[[data.source]]
kind = "camvid"
path = "camvid"
[schedule]
steps = 100000
[loop]
checkpoint_every = 100000
log_every = 100000
"""


@pytest.fixture
def command(tmp_path):
    rng = np.random.default_rng(0)
    for index in range(4):
        rgb = rng.integers(0, 255, (40, 48, 3), dtype=np.uint8)
        label = rng.integers(0, 11, (40, 48), dtype=np.uint8)
        camvid.write_frame(tmp_path / "camvid", rgb, label, str(index))
    (tmp_path / "r.toml").write_text(RECIPE)
    (tmp_path / "stopped.py").write_text(TRAIN)
    run = ["r.toml", "--data", str(tmp_path), "--out", str(tmp_path / "run")]
    return [str(tmp_path / "stopped.py"), str(tmp_path / run[0]), *run[1:]]


@pytest.fixture
def start(start_process):
    """Start the command in a group of its own, as a terminal does."""

    def start(command, *launcher, wait=""):
        environment = {**os.environ, "WAIT": wait}
        return start_process(sys.executable, "-W", "ignore", *launcher, *command, env=environment)

    return start


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_saves_and_stops(command, tmp_path, number, start):
    process = start(command)
    for _ in range(3):
        assert process.stdout.readline().endswith(" step\n")
    os.killpg(process.pid, number)  # the loader's worker gets it, too
    output, errors = process.communicate(timeout=120)
    last = tmp_path / "run" / "last.pt"
    assert process.returncode == 130
    assert f"stopped; the same command resumes from {last}" in errors
    assert "Traceback" not in errors
    assert load_checkpoint(last).trainer["step"] == 3 + output.count(" step\n")
    assert not (tmp_path / "run" / "model.pt").exists()


@pytest.mark.slow
def test_a_second_signal_stops_at_once(command, tmp_path, start):
    process = start(command, wait="step")
    assert process.stdout.readline().endswith(" step\n")
    os.killpg(process.pid, signal.SIGINT)
    while "stopping after this step" not in process.stderr.readline():
        assert process.poll() is None
    time.sleep(0.3)  # else it is the same signal
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=60) == 130
    assert not (tmp_path / "run" / "last.pt").exists()


def test_no_traceback_while_it_is_still_importing(command, start):
    process = start(command, wait="importing")
    assert process.stdout.readline().endswith(" importing\n")
    os.killpg(process.pid, signal.SIGINT)
    errors = process.communicate("\n", timeout=120)[1]
    assert process.returncode == 130
    assert "Traceback" not in errors


@pytest.mark.slow
def test_several_processes_stop_at_the_same_step(command, tmp_path, start):
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
    process = start(command, *launcher)
    first: dict[str, str] = {}
    output = ""
    while len(first) < 2:
        line = process.stdout.readline()
        rank, number, _ = line.split()
        first[rank] = number
        output += line
    os.kill(int(first["1"]), signal.SIGTERM)  # one of them alone
    output += process.communicate(timeout=180)[0]
    steps = load_checkpoint(tmp_path / "run" / "last.pt").trainer["step"]
    assert [sum(line[0] == rank for line in output.splitlines()) for rank in "01"] == [steps] * 2


def test_two_signals_of_one_key_do_not_cut_torchrun_s_processes_short(monkeypatch):
    """The terminal sends one to every process of the group, and torchrun passes its own on."""
    monkeypatch.setenv("WORLD_SIZE", "2")
    with stop_signal() as stop:
        assert not stop()
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)
        assert stop()
