"""The table of the parts of the depth head: without each part the depth is another."""

import torch

import depth_parts
from models import load_checkpoint
from training.initial_weights import find_weights


@torch.no_grad()
def test_each_part_is_left_out_and_comes_back():
    network = load_checkpoint(find_weights("ssdnet-lite")).model
    torch.manual_seed(0)
    depth = torch.where(torch.rand(1, 1, 96, 160) < 0.05, 40 * torch.rand(1, 1, 96, 160), 0.0)
    rgb = torch.randint(0, 255, (1, 3, 96, 160)).float()
    whole = network(rgb, depth).depths[0]
    for part, leave_out in depth_parts.PARTS.items():
        with leave_out():
            without = network(rgb, depth).depths[0]
        assert torch.equal(without, whole) == (part == "nothing"), part
    assert torch.equal(network(rgb, depth).depths[0], whole)
