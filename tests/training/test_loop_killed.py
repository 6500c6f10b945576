"""A training killed at any moment resumes to the same weights."""

import os
import signal
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from models import load_checkpoint

pytestmark = pytest.mark.slow

# Trains a small network on CamVid's layout for each folder that it reads, in a forked process:
# PyTorch is imported once. In the middle of writing a checkpoint that one says so, and waits for a
# line.
TRAIN = """
import os, sys
from pathlib import Path
import torch, torch._dynamo
from models import SSDNetLite, SSDNetLiteConfig
from models.registry import NETWORKS, Entry
NETWORKS["ssdnet-lite"] = Entry(SSDNetLite, SSDNetLiteConfig(
    encoder_widths=(8,) * 16, decoder_channels=(8, 8, 8),
))
torch.set_num_threads(1)
write = os.fsync
def ask(handle):
    print("writing", flush=True)
    sys.stdin.readline()
    write(handle)
os.fsync = ask
from training.datasets.camvid import CamVidRecipe
from training.loading.augment import AugmentConfig
from training.loop import train
from training.recipe import *
recipe = Recipe(
    model=ModelRecipe("ssdnet-lite"),
    data=DataRecipe(
        (CamVidRecipe(path="camvid"),), AugmentConfig(crop=(32, 32)), batch_size=2,
        workers=1,
    ),
    schedule=ScheduleRecipe(steps=12),
    loop=LoopRecipe(checkpoint_every=3, log_every=1),
)
for line in iter(sys.stdin.readline, ""):
    if not (out := line.strip()):
        continue  # the answer that a killed process did not read
    if (child := os.fork()) == 0:
        print(os.getpid(), flush=True)
        train(recipe, data=[Path(sys.argv[1])], out=Path(out))
        os._exit(0)
    print("ended", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture
def data(tmp_path):
    rng = np.random.default_rng(0)
    for folder, shape, top in (("train", (40, 48, 3), 255), ("trainannot", (40, 48), 11)):
        (tmp_path / "data" / "camvid" / folder).mkdir(parents=True)
        for index in range(4):
            image = rng.integers(0, top, shape, dtype=np.uint8)
            cv2.imwrite(str(tmp_path / "data" / "camvid" / folder / f"{index}.png"), image)
    return tmp_path / "data"


def test_killed_at_any_moment_it_resumes_to_the_same_weights(data, tmp_path, start_process):
    server = start_process(sys.executable, "-W", "ignore", "-c", TRAIN, data, stderr=None)

    def start(out: Path) -> int:
        print(out, file=server.stdin, flush=True)
        return int(server.stdout.readline())

    def end() -> int:
        """The exit code of what was started."""
        while (line := server.stdout.readline()) == "writing\n":
            print(file=server.stdin, flush=True)
        return int(line.removeprefix("ended "))

    start(tmp_path / "whole")
    assert end() == 0
    out = tmp_path / "killed"
    # In the middle of writing the first, of writing a later one, and somewhere after writing one.
    for writes, ends_writing in ((1, False), (2, False), (1, True)):
        process = start(out)
        for written in range(writes):
            if written:
                print(file=server.stdin, flush=True)
            assert server.stdout.readline() == "writing\n"
        if ends_writing:
            print(file=server.stdin, flush=True)
        os.kill(process, signal.SIGKILL)
        assert end() == -signal.SIGKILL
        assert not (out / "model.pt").exists()
    steps = load_checkpoint(out / "last.pt").trainer["step"]
    assert 3 <= steps < 12
    start(out)
    assert end() == 0
    expected = load_checkpoint(tmp_path / "whole" / "last.pt")
    reached = load_checkpoint(out / "last.pt")
    assert reached.trainer["step"] == 12
    for name, value in expected.model.state_dict().items():
        assert torch.equal(reached.model.state_dict()[name], value), name
    left = sorted(path.name for path in out.iterdir() if path.name != "tensorboard")
    assert left == [".ssdnet", "last.pt", "model.pt", "recipe.json"]
