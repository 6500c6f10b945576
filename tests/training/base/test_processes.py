"""Two processes, as torchrun starts them, train what one does with the large batch."""

import copy
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.distributed as dist
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import nn

from layouts.pictures import write
from models import load_checkpoint
from training.base.processes import Processes, share_batch_norm

# Every term of the loss, on a set whose frames differ in how much of them is known. PyTorch is
# imported once; the processes of each run are forked, with the environment that torchrun sets.
TRAIN = """
import json, os, shutil, socket, sys
from dataclasses import replace
from pathlib import Path
import torch
from models import SSDNet
from models.registry import NETWORKS, Entry
NETWORKS["ssdnet-small"] = Entry(SSDNet, replace(
    NETWORKS["ssdnet-small"].config, stem_channels=(8,), encoder_channels=(8, 8, 8, 8),
    encoder_blocks=(1, 1, 1, 1), decoder_channels=(8, 8, 8, 8), boundary_channels=4,
))
torch.set_num_threads(1)
from training.run import loop
from training.run import state
from training.datasets.folders import FoldersRecipe
from training.loading.augment import AugmentConfig
from training.losses import LossConfig
from training.run.recipe import *
from training.run.training_run import TrainingRun
source = FoldersRecipe(
    path="scenes", labels="labels", depth="depth", intrinsics=(60.0, 60.0, 28.0, 20.0)
)
recipe = Recipe(
    model=ModelRecipe("ssdnet-small"),
    data=DataRecipe((source,), AugmentConfig(crop=(40, 56)), workers=0),
    schedule=ScheduleRecipe(steps=2),
    loss=LossConfig(weights={"semantic_iou": 0.5}, weighting="uncertainty"),
    optimizer=OptimizerRecipe(name="sgd", learning_rate=0.05),
    loop=LoopRecipe(checkpoint_every=3, log_every=1, clip_norm=1.0),
    validation=ValidationRecipe(every=2, source=(source,), pictures=1),
)
share = state.share_network
def train(data, out, *, batch=2, parts=1, stop_rank=None):
    def keep(network, processes):
        nonlocal kept
        kept = network
        torch.save(network.state_dict(), out / f"rank{processes.rank}.start")
        return share(network, processes)
    kept = None
    state.share_network = keep
    run = replace(
        recipe,
        data=replace(recipe.data, batch_size=batch),
        loop=replace(recipe.loop, accumulate=parts),
    )
    steps = iter([False, os.environ["RANK"] == stop_rank])  # one of them is told to stop
    loop.train(run, TrainingRun([data], out, stop=lambda: next(steps, False)))
    torch.save(kept.state_dict(), out / f"rank{os.environ['RANK']}.weights")
root = Path(sys.argv[1])
for name, processes, options in json.loads(sys.argv[2]):
    if name == "resumed":
        shutil.copytree(root / "stopped", root / name)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    children = []
    for rank in range(processes):
        children.append(os.fork())
        if children[-1] == 0:
            os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
            os.environ |= {"RANK": str(rank), "WORLD_SIZE": str(processes)}
            train(root / "data", root / name, **options)
            os._exit(0)
    assert [os.waitpid(child, 0)[1] for child in children] == [0] * processes, name
"""
RUNS = [
    ("one", 1, {"batch": 4, "parts": 2}), ("two", 2, {"parts": 2}), ("whole", 2, {}),
    ("stopped", 2, {"stop_rank": "1"}), ("resumed", 2, {}),
]  # fmt: skip


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """The folder of RUNS."""
    root = tmp_path_factory.mktemp("distributed")
    rng = np.random.default_rng(0)
    for index in range(6):
        label = np.full((40, 56), 3, np.uint8)
        label[:, : 5 + 8 * index] = 8
        label[: 6 * index] = 255  # more and more of it
        depth = (256 * rng.uniform(3, 70, (40, 56))).astype(np.uint16)
        depth[: 3 * index] = 0
        image = rng.integers(0, 255, (40, 56, 3), dtype=np.uint8)
        for kind, picture in (("images", image), ("labels", label), ("depth", depth)):
            write(root / "data" / "scenes" / kind / f"{index}.png", picture)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", TRAIN, root, json.dumps(RUNS)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return root


def scores_of(run: Path) -> dict[str, float]:
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    names = [name for name in events.Tags()["scalars"] if name.startswith("validation/")]
    assert len(names) == 4
    return {name: events.Scalars(name)[-1].value for name in names}


def joined(state: dict[str, torch.Tensor], kind: str) -> torch.Tensor:
    return torch.cat([value.flatten().float() for name, value in state.items() if kind in name])


@pytest.mark.slow
def test_two_processes_train_what_one_trains_with_the_large_batch(root):
    one, two = root / "one", root / "two"
    first, second = (torch.load(two / f"rank{rank}.weights") for rank in (0, 1))
    expected, start = torch.load(one / "rank0.weights"), torch.load(one / "rank0.start")
    for name in expected:
        assert torch.equal(first[name], second[name]), name
    # Rounding turns single ReLUs over, and two steps make more of it: 0.01 to 1 % are measured. A
    # loss averaged over the processes instead of over all pixels, or batch statistics of one
    # process, differ by tens of percent.
    for kind in (".running_", "weight", "bias"):
        moved = joined(expected, kind) - joined(start, kind)
        assert moved.norm() > 0.01
        assert (joined(first, kind) - joined(expected, kind)).norm() < 0.05 * moved.norm()
    variances = [
        load_checkpoint(out / "last.pt").trainer["criterion"]["log_variances.depth"]
        for out in (one, two)
    ]
    assert variances[0] != 0
    assert variances[1] == pytest.approx(variances[0].item(), rel=0.05)
    assert scores_of(two) == pytest.approx(scores_of(one), rel=0.05)
    shipped = [load_checkpoint(out / "model.pt").model.state_dict() for out in (one, two)]
    difference = joined(shipped[0], "") - joined(shipped[1], "")
    assert difference.norm() < 1e-3 * joined(shipped[0], "").norm()
    assert sorted(path.name for path in two.iterdir()) == [
        *(".ssdnet", "best.pt", "last.pt", "model.pt"),
        *("rank0.start", "rank0.weights", "rank1.start", "rank1.weights"),
        *("recipe.json", "scores.csv", "tensorboard", "validation.html"),
    ]
    assert len(list((two / "tensorboard").iterdir())) == 1  # one of them writes


@pytest.mark.slow
def test_two_processes_resume_to_the_same_weights(root):
    whole, stopped, resumed = root / "whole", root / "stopped", root / "resumed"
    expected = torch.load(whole / "rank0.weights")
    halfway = torch.load(stopped / "rank0.weights")
    assert any(not torch.equal(halfway[name], expected[name]) for name in expected)
    assert not (stopped / "model.pt").exists()
    assert load_checkpoint(stopped / "last.pt").trainer["step"] == 1
    for rank in (0, 1):
        reached = torch.load(resumed / f"rank{rank}.weights")
        for name in expected:
            assert torch.equal(reached[name], expected[name]), name
    shipped = [load_checkpoint(out / "model.pt").model.state_dict() for out in (whole, resumed)]
    assert all(torch.equal(shipped[0][name], shipped[1][name]) for name in shipped[0])
    assert scores_of(resumed) == scores_of(whole)


def test_shares_of_the_processes_make_up_one_process_s_batches():
    device = torch.device("cpu")
    alone = Processes(0, 1, device).shares(12, 36, 6)
    parts = [Processes(rank, 3, device).shares(12, 36, 2) for rank in range(3)]
    assert alone == list(range(12, 36))
    for batch in range(4):
        joined = [index for part in parts for index in part[2 * batch : 2 * batch + 2]]
        assert joined == alone[6 * batch : 6 * batch + 6]


def test_shared_batch_norm_is_batch_norm(tmp_path):
    """The group has one process; with several, the sums come from all of them."""
    torch.manual_seed(0)
    plain = nn.BatchNorm2d(3)
    nn.init.uniform_(plain.weight, 0.5, 2)
    nn.init.uniform_(plain.bias, -1, 1)
    network = nn.Sequential(copy.deepcopy(plain))
    dist.init_process_group("gloo", init_method=f"file://{tmp_path}/group", rank=0, world_size=1)
    try:
        share_batch_norm(network)
        assert type(network[0]) is not nn.BatchNorm2d
        x = (5 + 3 * torch.randn(4, 3, 6, 5)).requires_grad_()
        twin = x.detach().clone().requires_grad_()
        down = torch.randn(4, 3, 6, 5)
        (network(x) * down).sum().backward()
        (plain(twin) * down).sum().backward()
    finally:
        dist.destroy_process_group()
    torch.testing.assert_close(x.grad, twin.grad, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(network[0].weight.grad, plain.weight.grad, rtol=1e-4, atol=1e-4)
    assert network.state_dict().keys() == {f"0.{name}" for name in plain.state_dict()}
    for name, value in plain.state_dict().items():
        torch.testing.assert_close(network.state_dict()[f"0.{name}"], value)
    torch.testing.assert_close(network.eval()(x), plain.eval()(x))
