"""Eq. 5 against a plain loop, class weights by hand."""

import math

import numpy as np
import pytest
import torch

from training.losses.semantic import class_weights, weighted_cross_entropy


def test_class_weights_by_hand():
    counts = torch.tensor([800, 100, 50, 40, 10])  # frequencies .8 .1 .05 .04 .01, median .05
    expected = [0.0625, 0.5, 1.0, 1.25, 5.0]
    assert class_weights(counts, "median").tolist() == pytest.approx(expected)
    roots = [math.sqrt(value) for value in expected]
    assert class_weights(counts, "sqrt_median").tolist() == pytest.approx(roots)
    assert class_weights(counts, "paper").tolist() == pytest.approx([0.8, 0.1, 0.05, 0.04, 0.01])
    assert class_weights(counts, "none").tolist() == [1.0] * 5


def test_class_weights_of_unseen_and_even_counts():
    weights = class_weights(torch.tensor([30, 0, 10]), "median")  # median of .75 and .25 is .5
    assert weights.tolist() == pytest.approx([2 / 3, 2.0, 2.0])
    assert class_weights(torch.tensor([30, 0, 10]), "paper").tolist() == pytest.approx(
        [0.75, 0, 0.25]
    )
    with pytest.raises(ValueError, match="no labelled pixel"):
        class_weights(torch.zeros(3), "median")


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
        torch.from_numpy(semantic),
        weights,
        torch.from_numpy(sample_weight),
    )
    expected = cross_entropy_by_loops(logits, semantic, weights.numpy(), sample_weight)
    assert ours.item() == pytest.approx(expected, rel=1e-5)


def test_a_batch_of_light_labels_is_a_light_loss():
    log_probabilities = torch.log_softmax(torch.randn(2, 3, 4, 4), dim=1)
    semantic = torch.randint(0, 3, (2, 4, 4))
    full = weighted_cross_entropy(log_probabilities, semantic, torch.ones(3))
    light = weighted_cross_entropy(
        log_probabilities, semantic, torch.ones(3), torch.tensor([0.2, 0.2])
    )
    assert light.item() == pytest.approx(0.2 * full.item(), rel=1e-5)


def test_without_labels_loss_and_gradient_are_zero():
    logits = torch.randn(1, 3, 4, 4, requires_grad=True)
    semantic = torch.full((1, 4, 4), 255)
    loss = weighted_cross_entropy(torch.log_softmax(logits, dim=1), semantic, torch.ones(3))
    loss.backward()
    assert loss.item() == 0.0
    assert logits.grad.abs().max() == 0.0
