"""What the deploy graph says where the network's scores are not finite."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from export.deploy import DeployGraph
from export.trace import trace
from models import NetworkOutput, SSDNet
from models.blocks import repeat
from models.registry import NETWORKS
from runtime.contract import NO_CLASS
from runtime.session import open_session

STRIDE = 2


class ScoresByColour(nn.Module):
    """Scores on a grid of half the size: each colour is one, and one of 255 is not finite.

    zero_at: 255 turns it into 0 / 0, NaN; 254 into 1 / 0, Inf; 256 into -1 / 0, -Inf.
    """

    config = SimpleNamespace(name="by-hand", max_depth_m=80.0)
    heads = ("semantic",)
    semantic_stride = STRIDE

    def __init__(self, zero_at: float) -> None:
        super().__init__()
        self.register_buffer("zero_at", torch.tensor(zero_at))

    def predict_coarse(self, rgb: torch.Tensor, sparse_depth: torch.Tensor) -> NetworkOutput:
        x = (rgb + 0 * sparse_depth)[:, :, ::STRIDE, ::STRIDE]
        scores = (x - self.zero_at) / (x != 255).to(x.dtype)
        return NetworkOutput(semantic_logits=scores)


def open_with(model: onnx.ModelProto, name: str, value: float, place: int):
    """Open the graph with another value at a place of the weights of that name."""
    model = copy.deepcopy(model)
    (weights,) = [each for each in model.graph.initializer if each.name == f"model.{name}"]
    values = onnx.numpy_helper.to_array(weights).copy()
    values.reshape(-1)[place] = value
    weights.CopyFrom(onnx.numpy_helper.from_array(values, weights.name))
    return open_session(model.SerializeToString(), threads=1)


@pytest.fixture(scope="module")
def by_colour():
    """The graph of `ScoresByColour`, traced once."""
    return trace(DeployGraph(ScoresByColour(0.5)), size=(32, 48), dynamic=True)


@pytest.mark.parametrize("zero_at", [254.0, 255.0, 256.0])
def test_a_pixel_with_scores_that_are_not_finite_has_no_class(zero_at, by_colour):
    network = ScoresByColour(zero_at)
    session = open_with(by_colour, "zero_at", zero_at, 0)
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (3, 32, 48, 3), dtype=np.uint8)
    for colour in range(3):
        rgb[0, 2 * rng.integers(16), 2 * rng.integers(24), colour] = 255
    rgb[1, 0, 0] = 255  # all scores of a corner
    sparse_depth = np.zeros((3, 32, 48), np.float32)
    (semantic,) = session.run(["semantic"], {"rgb": rgb, "sparse_depth": sparse_depth})

    coarse = network.predict_coarse(
        torch.from_numpy(rgb).permute(0, 3, 1, 2).float(), torch.zeros(3, 1, 32, 48)
    )
    scores = repeat(coarse.semantic_logits, STRIDE)
    expected = scores.argmax(dim=1).to(torch.uint8).numpy()
    unknown = semantic == NO_CLASS
    assert unknown[~torch.isfinite(scores).all(dim=1).numpy()].all()
    assert (semantic == expected)[~unknown].all()
    assert [frame.any() for frame in unknown] == [True, True, False]
    assert unknown[0].sum() <= 3 * STRIDE**2
    assert unknown[1].sum() == STRIDE**2


def test_large_finite_scores_keep_their_class(by_colour):
    session = open_with(by_colour, "zero_at", -1e36, 0)
    rgb = np.zeros((1, 32, 48, 3), np.uint8)
    feed = {"rgb": rgb, "sparse_depth": np.zeros((1, 32, 48), np.float32)}
    assert not session.run(["semantic"], feed)[0].any()


@pytest.fixture(scope="module")
def small_network():
    """The graph of a small network, traced once."""
    config = replace(
        NETWORKS["ssdnet-sem"].config,
        encoder_channels=(8,),
        encoder_blocks=(1,),
        decoder_channels=(8,),
        boundary_channels=4,
    )
    network = SSDNet(config)
    with torch.no_grad():
        network.semantic_head.bias += torch.arange(config.num_classes)
    return trace(DeployGraph(network), size=(64, 96))


@pytest.mark.parametrize("name", ["semantic_head.bias", "encoder.stages.0.0.0.weight"])
def test_a_broken_network_answers_no_class(name, small_network):
    rgb = np.full((1, 64, 96, 3), 99, np.uint8)
    feed = {"rgb": rgb, "sparse_depth": np.zeros((1, 64, 96), np.float32)}
    session = open_with(small_network, name, 0.5, 3)
    assert (session.run(["semantic"], feed)[0] != NO_CLASS).all()
    session = open_with(small_network, name, float("nan"), 3)
    assert (session.run(["semantic"], feed)[0] == NO_CLASS).all()
