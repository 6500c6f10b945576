"""Answers: thin boundaries, and classes of scores that are not finite."""

import torch

from models.answers import answers, class_ids, with_thin_boundary
from models.network import CLASS_STRIDE, NetworkOutput, class_scores
from runtime.contract import NO_CLASS


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
        finer, decided = class_scores(scores, stride)
        assert decided == min(stride, CLASS_STRIDE)
        assert finer.shape[2:] == (4 * factor, 5 * factor)
    assert torch.equal(class_scores(scores, 2)[0], scores)
