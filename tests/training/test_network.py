"""What training does to a network's weights before they ship."""

import math

import torch

from training.network import adjust_logits


def test_logit_adjustment_gives_the_class_weights_back():
    """Odds of w * p turn into p, so that an even chance of a doubled class is no longer a win."""
    state = {"semantic_head.bias": torch.tensor([0.0, math.log(2.0)]), "other": torch.ones(2)}
    weights = torch.tensor([1.0, 2.0])
    whole = adjust_logits(state, weights, 1.0)
    torch.testing.assert_close(whole["semantic_head.bias"], torch.zeros(2))
    half = adjust_logits(state, weights, 0.5)
    torch.testing.assert_close(half["semantic_head.bias"][1], torch.tensor(0.5 * math.log(2.0)))
    assert torch.equal(
        adjust_logits(state, None, 1.0)["semantic_head.bias"], state["semantic_head.bias"]
    )
    assert torch.equal(whole["other"], state["other"])
