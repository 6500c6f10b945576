"""Answers: thin boundaries, classes of scores that are not finite, and outputs as declared."""

import re

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from models import create_model
from models.answers import answers, check_output, class_ids, with_thin_boundary
from models.blocks import pad_to_multiple
from models.network import CLASS_STRIDE, Network, NetworkConfig, NetworkOutput, to_class_grid
from runtime.contract.contract import NO_CLASS


def test_a_boundary_is_halved_where_the_class_does_not_change():
    ids = torch.zeros(1, 6, 8, dtype=torch.uint8)
    ids[:, :, 5:] = 3
    ids[:, 0, 0] = 250  # the difference of the ids does not matter
    boundary = torch.full((1, 6, 8), 0.8)
    boundary[0, 5, 7] = float("nan")
    thin = with_thin_boundary({"semantic": ids, "boundary": boundary})["boundary"]
    expected = torch.full((6, 8), 0.4)
    expected[:, 4:] = 0.8  # the columns 0, 2, 4 and 6 are looked at
    expected[:4, :4] = 0.8
    expected[5, 7] = 0.4
    assert thin[0, 5, 7].isnan()
    assert torch.equal(thin[0].nan_to_num(0.4), expected)


def test_without_classes_the_boundary_is_the_decoders():
    logits = torch.randn(2, 1, 5, 7)
    found = answers(NetworkOutput(boundary_logits=logits), 80.0)
    assert torch.equal(found["boundary"], torch.sigmoid(logits[:, 0]))


def test_pixels_of_scores_that_are_not_finite_have_no_class():
    scores = torch.zeros(1, 3, 4, 5)
    scores[:, 2] = 1
    scores[0, 0, 0, 0] = float("inf")
    scores[0, 1, 3, 4] = float("nan")
    expected = torch.full((1, 4, 5), 2, dtype=torch.uint8)
    expected[0, 0, 0] = expected[0, 3, 4] = NO_CLASS
    assert torch.equal(class_ids(scores), expected)


def test_classes_are_decided_on_a_grid_of_at_most_two_pixels():
    scores = torch.randn(1, 3, 4, 5)
    for stride, factor in ((1, 1), (2, 1), (4, 2), (8, 4)):
        finer, decided = to_class_grid(scores, stride)
        assert decided == min(stride, CLASS_STRIDE)
        assert finer.shape[2:] == (4 * factor, 5 * factor)
    assert torch.equal(to_class_grid(scores, 2)[0], scores)


class Small(Network):
    """A network of both heads on half the grid, right unless a test changes it."""

    heads = ("semantic", "depth")
    stride, semantic_stride, depth_stride = 4, 2, 2

    def __init__(self):
        super().__init__(NetworkConfig("small"))
        self.semantic_head = nn.Conv2d(3, self.config.num_classes, 1)

    def predict_coarse(self, rgb, sparse_depth):
        x = F.avg_pool2d(pad_to_multiple(rgb, self.stride), 2)
        return NetworkOutput(self.semantic_head(x), (torch.sigmoid(x[:, :1]),))


def returns(change):
    def predict_coarse(self, rgb, sparse_depth):
        found = Small.predict_coarse(self, rgb, sparse_depth)
        return change(found)

    return {"predict_coarse": predict_coarse}


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"depth_stride": 1}, "depth_stride, which is 1"),
        ({"heads": ("semantic", "depth", "boundary")}, "boundary must be in both"),
        (returns(lambda found: found._replace(semantic_logits=None)), "semantic must be in both"),
        (returns(lambda found: found._replace(depths=found.depths[0])), "a tuple"),
        (returns(lambda found: found.depths), "NetworkOutput"),
        (returns(lambda found: found._replace(depths=(80 * found.depths[0],))), "return 0..1"),
        (returns(lambda found: found._replace(depths=(float("nan") * found.depths[0],))), "NaN"),
        (
            returns(lambda found: found._replace(semantic_logits=found.semantic_logits[:, :5])),
            r"\(1, 11, 19, 27\)",
        ),
        ({"predict_coarse": lambda self, rgb, depth: rgb + rgb[..., ::2]}, "pad_to_multiple"),
    ],
)
def test_a_network_that_does_not_return_what_it_declares_is_named(changed, named):
    check_output(Small())
    network = type("Changed", (Small,), changed)()
    with pytest.raises(ValueError, match=named) as caught:
        check_output(network)
    assert re.search(r": [^.].*[^.]$", str(caught.value)), "what: remedy"
    assert network.training


def test_the_last_layer_of_the_classes_has_its_name():
    network = Small()
    network.scores = network.semantic_head
    del network.semantic_head
    network.predict_coarse = lambda rgb, depth: NetworkOutput(
        network.scores(pad_to_multiple(rgb, 4)[:, :, ::2, ::2]),
        (torch.zeros(1, 1, 20, 28),),
    )
    with pytest.raises(ValueError, match="semantic_head"):
        check_output(network)


@pytest.mark.parametrize("name", ["ssdnet-small", "ssdnet-nano", "erfnet", "sparse-conv"])
def test_networks_return_what_they_declare(name):
    check_output(create_model(name))
