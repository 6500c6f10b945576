"""The table of the parts of the depth head: without each part the depth is another."""

import pytest
import torch

import depth_parts
from models import load_checkpoint
from training.initial_weights import find_weights


@pytest.fixture(scope="module")
def predict():
    network = load_checkpoint(find_weights("ssdnet-lite")).model
    torch.manual_seed(0)
    depth = torch.where(torch.rand(1, 1, 96, 160) < 0.05, 40 * torch.rand(1, 1, 96, 160), 0.0)
    rgb = torch.randint(0, 255, (1, 3, 96, 160)).float()

    @torch.no_grad()
    def run():
        return network(rgb, depth).depths[0]

    return run


@pytest.mark.parametrize("part", [part for part in depth_parts.PARTS if part != "nothing"])
def test_a_part_is_left_out_and_comes_back(predict, part):
    whole = predict()
    with depth_parts.PARTS[part]():
        without = predict()
    assert torch.isfinite(without).all()
    assert not torch.equal(without, whole)
    assert torch.equal(predict(), whole)
