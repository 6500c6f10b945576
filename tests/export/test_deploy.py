"""What the deploy graph says where the network's scores are not finite."""

from types import SimpleNamespace

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from export.deploy import DeployGraph
from export.trace import trace
from models import Network, NetworkOutput
from models.blocks import upsample_nearest
from runtime.contract.contract import NO_CLASS
from runtime.engine.session import open_session

STRIDE = 2


class ScoresByColour(nn.Module):
    """Scores on a grid of half the size: each colour is one, and one of 255 is not finite.

    zero_at: 255 turns it into 0 / 0, NaN; 254 into 1 / 0, Inf; 256 into -1 / 0, -Inf.
    """

    heads = ("semantic",)
    semantic_stride = STRIDE
    join_rows = Network.join_rows

    def __init__(self, zero_at: float, class_rows: tuple[int, ...] = ()) -> None:
        super().__init__()
        self.config = SimpleNamespace(name="by-hand", max_depth_m=80.0, class_rows=class_rows)
        self.register_buffer("zero_at", torch.tensor(zero_at))

    def predict_coarse(self, rgb: torch.Tensor, sparse_depth: torch.Tensor) -> NetworkOutput:
        x = (rgb + 0 * sparse_depth)[:, :, ::STRIDE, ::STRIDE]
        scores = (x - self.zero_at) / (x != 255).to(x.dtype)
        return NetworkOutput(semantic_logits=scores)


@pytest.fixture(scope="module")
def answer_by_colour():
    """Run the graph of `ScoresByColour`, which is traced once."""
    model = trace(DeployGraph(ScoresByColour(0.5)), size=(32, 48), dynamic=True)
    (weights,) = [each for each in model.graph.initializer if each.name == "model.zero_at"]

    def answer(zero_at, rgb):
        value = np.float32(zero_at)
        weights.CopyFrom(onnx.numpy_helper.from_array(value, weights.name))
        content = model.SerializeToString()
        session = open_session(content, threads=1)
        feed = {"rgb": rgb, "sparse_depth": np.zeros(rgb.shape[:3], np.float32)}
        return session.run(["semantic"], feed)[0]

    return answer


@pytest.mark.parametrize("zero_at", [254.0, 255.0, 256.0])
def test_a_pixel_with_scores_that_are_not_finite_has_no_class(zero_at, answer_by_colour):
    network = ScoresByColour(zero_at)
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (3, 32, 48, 3), dtype=np.uint8)
    for colour in range(3):
        rgb[0, 2 * rng.integers(16), 2 * rng.integers(24), colour] = 255
    rgb[1, 0, 0] = 255  # all scores of a corner
    semantic = answer_by_colour(zero_at, rgb)

    coarse = network.predict_coarse(
        torch.from_numpy(rgb).permute(0, 3, 1, 2).float(), torch.zeros(3, 1, 32, 48)
    )
    scores = upsample_nearest(coarse.semantic_logits, STRIDE)
    expected = scores.argmax(dim=1).to(torch.uint8).numpy()
    unknown = semantic == NO_CLASS
    assert unknown[~torch.isfinite(scores).all(dim=1).numpy()].all()
    assert (semantic == expected)[~unknown].all()
    assert [frame.any() for frame in unknown] == [True, True, False]
    assert unknown[0].sum() <= 3 * STRIDE**2
    assert unknown[1].sum() == STRIDE**2


def test_large_finite_scores_keep_their_class(answer_by_colour):
    assert not answer_by_colour(-1e36, np.zeros((1, 32, 48, 3), np.uint8)).any()


def test_the_exported_answer_of_joined_rows_is_the_answer_of_the_rows_joined():
    model = trace(DeployGraph(ScoresByColour(0.5, class_rows=(2, 1))), size=(32, 48))
    rgb = np.random.default_rng(0).integers(0, 255, (2, 32, 48, 3), dtype=np.uint8)
    feed = {"rgb": rgb, "sparse_depth": np.zeros(rgb.shape[:3], np.float32)}
    (semantic,) = open_session(model.SerializeToString(), threads=1).run(["semantic"], feed)
    by_colour = rgb[:, ::STRIDE, ::STRIDE].argmax(axis=-1).repeat(STRIDE, 1).repeat(STRIDE, 2)
    assert (semantic == np.uint8([0, 0, 1])[by_colour]).all()
