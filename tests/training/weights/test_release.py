"""Functions of trained weights; `test_stages` mixes weights and adds offsets."""

import math

import pytest
import torch

from models import create_model
from training.weights.release import adjust_logits

BIAS = "semantic_head.bias"


def test_logit_adjustment_undoes_the_class_weights():
    """Odds of w * p turn into p, so that an even chance of a doubled class is no longer a win."""
    network = create_model("ssdnet-lite")
    with torch.no_grad():
        network.semantic_head.bias.zero_()
        network.semantic_head.bias[1] = math.log(2.0)
    weights = torch.ones(network.config.num_classes)
    weights[1] = 2.0

    def adjusted(share, weights=weights):
        return adjust_logits(network, weights, share).state_dict()

    torch.testing.assert_close(adjusted(1.0)[BIAS], torch.zeros(len(weights)))
    torch.testing.assert_close(adjusted(0.5)[BIAS][1], torch.tensor(0.5 * math.log(2.0)))
    state = network.state_dict()
    assert torch.equal(adjusted(0.0)[BIAS], state[BIAS])
    assert torch.equal(adjusted(1.0, torch.ones(()))[BIAS], state[BIAS])
    assert state[BIAS][1] == pytest.approx(math.log(2.0))
    changed = {name for name, value in adjusted(1.0).items() if not torch.equal(value, state[name])}
    assert changed == {BIAS}
