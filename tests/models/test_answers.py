"""Answers: thin boundaries, and classes of scores that are not finite."""

import torch

from models.answers import answers, class_ids, with_thin_boundary
from models.network import NetworkOutput
from runtime.contract import NO_CLASS


def test_a_boundary_is_halved_where_the_class_does_not_change():
    ids = torch.zeros(1, 6, 8, dtype=torch.uint8)
    ids[:, :, 5:] = 3
    ids[:, 0, 0] = 250  # the difference of the ids does not matter
    boundary = torch.full((1, 6, 8), 0.8)
    boundary[0, 5, 7] = float("nan")
    thin = with_thin_boundary({"semantic": ids, "boundary": boundary})["boundary"]
    expected = torch.full((6, 8), 0.4)
    expected[:, 4:6] = 0.8
    expected[:2, :2] = 0.8
    assert thin[0, 5, 7].isnan()
    assert torch.equal(thin[0].nan_to_num(0.4), expected)


def test_without_classes_the_boundary_is_the_decoders():
    logits = torch.randn(2, 1, 5, 7)
    found = answers(NetworkOutput(boundary_logits=logits), 80.0)
    assert torch.equal(found["boundary"], torch.sigmoid(logits[:, 0]))


def test_scores_that_are_not_finite_reach_the_cells_beside_them():
    scores = torch.zeros(1, 3, 4, 5)
    scores[:, 2] = 1
    scores[0, 0, 0, 0] = float("inf")
    scores[0, 1, 3, 4] = float("nan")
    full = class_ids(scores)
    assert (full == NO_CLASS).nonzero().tolist() == [[0, 0, 0], [0, 3, 4]]
    ids = class_ids(scores, 2)
    assert ids.shape == (1, 8, 10)
    unknown = torch.zeros(8, 10, dtype=torch.bool)
    unknown[:3, :3] = unknown[5:, 7:] = True  # pixels that the cell takes part in
    assert torch.equal(ids[0] == NO_CLASS, unknown)
    assert (ids[0][~unknown] == 2).all()
