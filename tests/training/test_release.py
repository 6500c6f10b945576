"""What is made of trained weights before they are used."""

import math

import pytest
import torch

from models import create_model
from training.release import add_offsets, adjust_logits, mix_weights

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


def test_mixed_weights_lie_between_those_before_and_after():
    before, after = create_model("ssdnet-lite"), create_model("ssdnet-lite")
    expected = {
        name: 0.75 * value + 0.25 * after.state_dict()[name]
        for name, value in before.state_dict().items()
        if value.is_floating_point()
    }
    after.encoder.stem[0][1].num_batches_tracked.fill_(7)
    last = {name: value.clone() for name, value in after.state_dict().items()}
    mixed = mix_weights(before, after, 0.25).state_dict()
    for name, value in expected.items():
        torch.testing.assert_close(mixed[name], value)
    assert mixed["encoder.stem.0.1.num_batches_tracked"] == 7  # a count
    assert all(torch.equal(value, last[name]) for name, value in after.state_dict().items())
    for other in (None, create_model("ssdnet-lite", max_depth_m=80.0)):
        with pytest.raises(ValueError, match="mixing needs the weights before"):
            mix_weights(other, after, 0.25)


def test_offsets_are_added_to_the_logits_of_their_classes():
    network = create_model("ssdnet-lite")
    names = [info.name for info in network.config.classes]
    state = network.state_dict()
    moved = add_offsets(network, {"road": -0.5, "pole": 1.0}).state_dict()
    steps = dict(zip(names, (moved[BIAS] - state[BIAS]).tolist(), strict=True))
    assert {name: step for name, step in steps.items() if step} == pytest.approx(
        {"road": -0.5, "pole": 1.0}
    )
    assert {name for name in state if not torch.equal(moved[name], state[name])} == {BIAS}
