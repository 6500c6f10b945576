"""Two processes started by torchrun train the same network as one with the large batch."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

from models import load_checkpoint
from training.distributed import Processes, join_processes

# Every term of the loss, on a set whose frames differ in how much of them is known.
TRAIN = """
import os, sys
from dataclasses import replace
from pathlib import Path
import torch
from models.config import CONFIGS
CONFIGS["ssdnet-small"] = replace(
    CONFIGS["ssdnet-small"], stem_channels=(8,), encoder_channels=(8, 8, 8, 8),
    encoder_blocks=(1, 1, 1, 1), decoder_channels=(8, 8, 8, 8), boundary_channels=4,
)
torch.set_num_threads(1)
from training import loop
from training.augment import AugmentConfig
from training.losses import LossConfig
from training.recipe import *
data, out, batch, parts = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
source = SourceRecipe("rendered", "scenes")
recipe = Recipe(
    model=ModelRecipe("ssdnet-small"),
    data=DataRecipe((source,), AugmentConfig(crop=(40, 56)), batch_size=batch, workers=0),
    schedule=ScheduleRecipe(steps=3),
    loss=LossConfig(semantic_iou_weight=0.5, side_boundary_weight=0.5, weighting="uncertainty"),
    optimizer=OptimizerRecipe(name="sgd", learning_rate=0.05),
    loop=LoopRecipe(checkpoint_every=3, log_every=1, accumulate=parts, clip_norm=5.0),
    validation=ValidationRecipe(every=3, source=(source,), pictures=1),
)
share = loop.share_gradients
def keep(network, processes, **options):
    global kept
    kept = network
    torch.save(network.state_dict(), out / f"rank{processes.rank}.start")
    return share(network, processes, **options)
loop.share_gradients = keep
loop.train(recipe, data=[data], out=out)
torch.save(kept.state_dict(), out / f"rank{os.environ.get('RANK', 0)}.weights")
"""


@pytest.fixture
def data(tmp_path):
    rng = np.random.default_rng(0)
    folder = tmp_path / "data" / "scenes" / "Scene01" / "clone"
    for kind in ("rgb", "depth", "classSegmentation"):
        (folder / "frames" / kind / "Camera_0").mkdir(parents=True)
    (folder / "colors.txt").write_text("Category r g b\nRoad 100 60 100\nCar 0 9 9\nMisc 1 2 3\n")
    colors = np.array([[100, 60, 100], [9, 9, 0], [3, 2, 1]], np.uint8)
    rows = ["frame cameraID fx fy cx cy"]
    for index in range(6):
        label = np.zeros((40, 56), np.uint8)
        label[:, : 5 + 8 * index] = 1
        label[: 6 * index] = 2  # ignored: more and more of it
        depth = rng.integers(300, 7000, (40, 56)).astype(np.uint16)
        depth[: 3 * index] = 65535
        image = rng.integers(0, 255, (40, 56, 3), dtype=np.uint8)
        frames = folder / "frames"
        cv2.imwrite(str(frames / "rgb" / "Camera_0" / f"rgb_{index:05d}.jpg"), image)
        cv2.imwrite(str(frames / "depth" / "Camera_0" / f"depth_{index:05d}.png"), depth)
        labels = frames / "classSegmentation" / "Camera_0" / f"classgt_{index:05d}.png"
        cv2.imwrite(str(labels), colors[label])
        rows.append(f"{index} 0 60 60 28 20")
    (folder / "intrinsic.txt").write_text("\n".join(rows))
    return tmp_path / "data"


def run(tmp_path: Path, data: Path, name: str, *, processes: int, batch: int, parts: int = 1):
    script = tmp_path / "train.py"
    script.write_text(TRAIN)
    launcher = [
        *("-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"),
    ]
    command = [sys.executable, "-W", "ignore", *(launcher if processes > 1 else [])]
    out = tmp_path / name
    done = subprocess.run(
        [*command, str(script), str(data), str(out), str(batch), str(parts)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return out


def joined(state: dict[str, torch.Tensor], kind: str) -> torch.Tensor:
    return torch.cat([value.flatten().float() for name, value in state.items() if kind in name])


def test_two_processes_train_what_one_trains_with_the_large_batch(tmp_path, data):
    one = run(tmp_path, data, "one", processes=1, batch=4, parts=2)
    two = run(tmp_path, data, "two", processes=2, batch=2, parts=2)
    first, second = (torch.load(two / f"rank{rank}.weights") for rank in (0, 1))
    expected, start = torch.load(one / "rank0.weights"), torch.load(one / "rank0.start")
    for name in expected:
        assert torch.equal(first[name], second[name]), name
    # Rounding grows through three steps of a network; a loss averaged over the processes instead
    # of over all pixels, or batch statistics of one process, differ by far more than 1 %.
    for kind in (".running_", "weight"):
        moved = joined(expected, kind) - joined(start, kind)
        assert moved.norm() > 0.1
        assert (joined(first, kind) - joined(expected, kind)).norm() < 0.01 * moved.norm()
    shipped = [load_checkpoint(out / "model.pt").model.state_dict() for out in (one, two)]
    difference = joined(shipped[0], "") - joined(shipped[1], "")
    assert difference.norm() < 1e-3 * joined(shipped[0], "").norm()
    assert sorted(path.name for path in two.iterdir()) == [
        *("last.pt", "model.pt", "rank0.start", "rank0.weights", "rank1.start", "rank1.weights"),
        *("recipe.json", "tensorboard"),
    ]
    assert len(list((two / "tensorboard").iterdir())) == 1  # one of them writes


def test_shares_of_the_processes_make_up_one_process_s_batches():
    device = torch.device("cpu")
    alone = Processes(0, 1, device).shares(12, 36, 6)
    parts = [Processes(rank, 3, device).shares(12, 36, 2) for rank in range(3)]
    assert alone == list(range(12, 36))
    for batch in range(4):
        joined = [index for part in parts for index in part[2 * batch : 2 * batch + 2]]
        assert joined == alone[6 * batch : 6 * batch + 6]


def test_a_single_process_needs_no_launcher(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with join_processes("cpu") as processes:
        assert processes.is_first
        assert processes.gather("x") == ["x"]
        processes.wait()
        norm = nn.Sequential(nn.BatchNorm2d(2))
        from training.distributed import share_gradients, synchronise_batch_norm

        assert type(synchronise_batch_norm(norm, processes)[0]) is nn.BatchNorm2d
        assert share_gradients(norm, processes, synced_buffers=True) is norm
