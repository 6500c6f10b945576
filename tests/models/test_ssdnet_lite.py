"""The real-time network: its surfaces, its grids and what its configuration can say."""

import pytest
import torch

from models import create_model
from models.classes import CAMVID_CLASSES
from models.decoders import AddUpBlock
from models.surfaces import MIN_DEPTH


@pytest.mark.parametrize("name", ["ssdnet-lite", "ssdnet-nano"])
def test_answers_lie_in_their_range_with_and_without_returns(name):
    network = create_model(name).eval()
    rgb = torch.rand(1, 3, 70, 101) * 255
    with torch.no_grad():
        found = network(rgb, torch.full((1, 1, 70, 101), 12.0))
        none = network(rgb, torch.zeros(1, 1, 70, 101))
    assert not torch.equal(found.semantic_logits, none.semantic_logits)  # the encoder reads returns
    for answer in (found, none):
        assert answer.depths[0].isfinite().all()
        assert MIN_DEPTH <= answer.depths[0].min() <= answer.depths[0].max() <= 1.0
        assert answer.depth_uncertainty.min() > 0


def test_a_network_answers_as_if_an_isolated_return_were_not_there():
    network = create_model("ssdnet-nano").eval()
    rgb, depth = torch.rand(1, 3, 64, 96) * 255, torch.zeros(1, 1, 64, 96)
    depth[..., ::5, ::2] = 40.0
    spoiled = depth.clone()
    spoiled[0, 0, 33, 41] = 6.0
    with torch.no_grad():
        expected, answer = network(rgb, depth), network(rgb, spoiled)
    assert torch.equal(answer.depths[0], expected.depths[0])
    assert torch.equal(answer.semantic_logits, expected.semantic_logits)
    assert torch.equal(answer.depth_uncertainty, expected.depth_uncertainty)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"use_sparse_depth": False}, "fields of the network 'ssdnet-lite': use_sparse_depth"),
        ({"semantic_head": False, "depth_head": False}, "a semantic head, a depth head or both"),
        ({"decoder_channels": (8, 8)}, "one entry per skip .3., got 2"),
    ],
)
def test_what_cannot_be_built_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        create_model("ssdnet-lite", **changes)


@pytest.mark.parametrize("name", ["ssdnet-lite", "ssdnet-nano"])
def test_a_new_network_answers_with_the_base(name):
    torch.manual_seed(0)
    network = create_model(name).eval()
    rows = torch.arange(128).float().view(1, 1, -1, 1).expand(1, 1, 128, 192)
    plane = 200 / (4 + 0.1 * rows)
    sparse = torch.zeros_like(plane)
    sparse[..., 3::12, ::3] = plane[..., 3::12, ::3]
    with torch.no_grad():
        depth = 200 * network(torch.rand(1, 3, 128, 192) * 255, sparse).depths[0]
    error = (depth / plane - 1).abs()[..., 12:-12, 12:-12]
    assert error.median() < 1e-3
    assert error.max() < 0.03  # beside returns: the confidence in them is random


def scanned():
    """An image and returns of two surfaces."""
    rgb, sparse = torch.rand(1, 3, 64, 96) * 255, torch.zeros(1, 1, 64, 96)
    sparse[..., ::20, ::4], sparse[..., 10::20, ::4] = 12.0, 30.0
    return rgb, sparse


def trained(name):
    """A network whose depth departs from its base and reads the semantic decoder."""
    torch.manual_seed(0)
    network = create_model(name).eval()
    head = network.surface_depth
    for layer in (head.head, head.geometry[-1], head.semantics):
        torch.nn.init.normal_(layer.weight)
    return network


def test_the_choice_reads_the_features_of_the_semantic_decoder():
    """The layer is zero at first, so that weights without it give the same depth."""
    network, frame = trained("ssdnet-nano"), scanned()
    before = network(*frame).depths[0]
    before.sum().backward()
    for layer in (network.surface_depth.semantics, network.surface_depth.classes):
        assert layer.weight.grad.abs().max() > 0
    with torch.no_grad():
        network.surface_depth.semantics.weight.fill_(0.5)
        changed = network(*frame).depths[0]
    assert (changed - before).abs().max() > 1e-3


@pytest.mark.parametrize("name", ["ssdnet-lite", "ssdnet-nano"])
def test_other_classes_leave_the_depth_as_it_is(name):
    network, frame = trained(name), scanned()
    with torch.no_grad():
        before = network(*frame)
        for part in ("semantic_head", "semantic_coarse_head", "semantic_refine"):
            for weights in getattr(network, part, torch.nn.Identity()).parameters():
                weights.add_(0.1)
        after = network(*frame)
    assert not torch.equal(after.semantic_logits, before.semantic_logits)
    assert torch.equal(after.depths[0], before.depths[0])
    assert torch.equal(after.depth_uncertainty, before.depth_uncertainty)


def test_features_that_no_activation_bounds_do_not_drown_what_they_are_added_to():
    """Ten times the features leave the same batch the same: both are normalised."""
    torch.manual_seed(0)
    below, skip = torch.randn(2, 24, 4, 6), torch.randn(2, 40, 8, 12)
    block = AddUpBlock(24, 40, 16, separable=True).train()
    plain = block(below, skip)
    for scaled in (block(below, 10 * skip), block(10 * below, skip)):
        assert torch.allclose(scaled, plain, atol=1e-3)


def test_an_additive_refinement_adds_to_what_both_heads_answer_at_stride_4():
    torch.manual_seed(0)
    network, frame = create_model("ssdnet-lite").eval(), scanned()
    both = network.predict_coarse(*frame)
    both.depths[0].sum().backward()
    assert network.surface_depth.coarse_head.weight.grad.abs().max() > 0
    assert network.surface_depth.head.weight.grad.abs().max() > 0
    parts = []
    for silent in (network.semantic_head, network.semantic_coarse_head):
        kept = {name: value.clone() for name, value in silent.state_dict().items()}
        with torch.no_grad():
            silent.weight.zero_()
            silent.bias.zero_()
            parts.append(network.predict_coarse(*frame).semantic_logits)
        silent.load_state_dict(kept)
    coarse, fine = parts
    assert torch.allclose(coarse + fine, both.semantic_logits, atol=1e-5)
    assert min(coarse.std(), fine.std()) > 0


def test_rows_of_scores_are_joined_and_all_of_them_learn():
    """In evaluation by the maximum, in training by the sum of their probabilities."""
    classes = CAMVID_CLASSES[:2]
    network = create_model("ssdnet-nano", classes=classes, class_rows=(2, 1))
    rows = create_model("ssdnet-nano", classes=CAMVID_CLASSES[:3])
    rows.load_state_dict(network.state_dict())
    inputs = torch.rand(1, 3, 64, 96) * 255, torch.zeros(1, 1, 64, 96)
    with torch.no_grad():
        joined, alone = (each.eval()(*inputs).semantic_logits for each in (network, rows))
    assert torch.equal(joined.argmax(1), torch.tensor([0, 0, 1])[alone.argmax(1)])
    network.train()(*inputs).semantic_logits.sum().backward()
    assert (network.semantic_head.bias.grad > 0).all()
    scores = torch.rand(1, 3, 2, 2)
    summed = network.join_rows(scores).softmax(1)[:, 0]
    assert torch.allclose(summed, scores.softmax(1)[:, :2].sum(1))
    with pytest.raises(ValueError, match="class_rows must have one entry per class"):
        create_model("ssdnet-nano", classes=classes, class_rows=(2,))
