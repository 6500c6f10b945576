"""Eq. 5 against a plain loop, class weights by hand."""

import math

import numpy as np
import pytest
import torch

from training.losses.semantic import (
    class_shares,
    class_weights,
    soft_iou_loss,
    weighted_cross_entropy,
)


def test_class_weights_by_hand():
    counts = torch.tensor([800, 100, 50, 40, 10])  # frequencies .8 .1 .05 .04 .01, median .05
    expected = [0.0625, 0.5, 1.0, 1.25, 5.0]
    assert class_weights(counts, "median").tolist() == pytest.approx(expected)
    roots = [math.sqrt(value) for value in expected]
    assert class_weights(counts, "sqrt_median").tolist() == pytest.approx(roots)
    assert class_weights(counts, "paper").tolist() == pytest.approx([0.8, 0.1, 0.05, 0.04, 0.01])
    assert class_weights(counts, "none").tolist() == [1.0] * 5
    assert class_weights(0 * counts, "median").tolist() == [1.0] * 5


def test_class_weights_of_unseen_and_even_counts():
    weights = class_weights(torch.tensor([30, 0, 10]), "median")  # median of .75 and .25 is .5
    assert weights.tolist() == pytest.approx([2 / 3, 2.0, 2.0])
    assert class_weights(torch.tensor([30, 0, 10]), "paper").tolist() == pytest.approx(
        [0.75, 0, 0.25]
    )


def shares_of(semantic, like):
    """Shares on the grid of `like`, (N, C, h, w)."""
    return class_shares(torch.as_tensor(semantic), like.shape[1], tuple(like.shape[-2:])).to(like)


def cross_entropy_by_loops(logits, semantic, weights, sample_weight):
    total, count = 0.0, 0
    for n, v, u in np.ndindex(*semantic.shape):
        label = semantic[n, v, u]
        if label == 255:
            continue
        exponentials = [math.exp(value) for value in logits[n, :, v, u]]
        probability = exponentials[label] / sum(exponentials)
        total -= sample_weight[n] * weights[label] * math.log(probability)
        count += 1
    return total / count


@pytest.mark.parametrize("weighting", ["median", "sqrt_median", "paper", "none"])
def test_weighted_cross_entropy_equals_loops(weighting):
    rng = np.random.default_rng(0)
    logits = rng.standard_normal((2, 4, 5, 6)).astype(np.float32)
    semantic = rng.choice([0, 0, 0, 1, 2, 2, 3, 255], size=(2, 5, 6))
    weights = class_weights(torch.bincount(torch.from_numpy(semantic).flatten())[:4], weighting)
    sample_weight = np.array([1.0, 0.2], dtype=np.float32)
    ours = weighted_cross_entropy(
        torch.log_softmax(torch.from_numpy(logits), dim=1),
        shares_of(semantic, torch.from_numpy(logits)),
        weights,
        torch.from_numpy(sample_weight),
    )
    expected = cross_entropy_by_loops(logits, semantic, weights.numpy(), sample_weight)
    assert ours.item() == pytest.approx(expected, rel=1e-5)


def soft_iou_by_loops(probabilities, semantic, sample_weight):
    classes = probabilities.shape[1]
    losses = []
    for k in range(classes):
        both = predicted = labelled = 0.0
        for n, v, u in np.ndindex(*semantic.shape):
            if semantic[n, v, u] == 255:
                continue
            predicted += sample_weight[n] * probabilities[n, k, v, u]
            if semantic[n, v, u] == k:
                both += sample_weight[n] * probabilities[n, k, v, u]
                labelled += sample_weight[n]
        if labelled:
            losses.append(1 - both / (predicted + labelled - both))
    return sum(losses) / len(losses)


@pytest.mark.parametrize("sample_weight", [(1.0, 1.0), (1.0, 0.2), (0.0, 1.0)])
def test_soft_iou_equals_loops(sample_weight):
    rng = np.random.default_rng(0)
    logits = torch.from_numpy(rng.standard_normal((2, 5, 6, 7)))
    probabilities = torch.softmax(logits, dim=1)
    semantic = rng.choice([0, 0, 1, 2, 2, 255], size=(2, 6, 7))  # 3 and 4 are never seen
    semantic[1][semantic[1] == 1] = 0
    shares = shares_of(semantic, probabilities)
    loss = soft_iou_loss(probabilities, shares, torch.tensor(sample_weight).double())
    expected = soft_iou_by_loops(probabilities.numpy(), semantic, sample_weight)
    assert loss.item() == pytest.approx(expected, rel=1e-9)
