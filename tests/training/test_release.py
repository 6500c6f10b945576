"""What a training does to its weights before they ship."""

import math

import pytest
import torch

from models import create_model
from runtime.errors import InputError
from training.recipe import ReleaseRecipe
from training.release import Release, class_offsets, release_weights

BIAS = "semantic_head.bias"


def test_logit_adjustment_undoes_the_class_weights():
    """Odds of w * p turn into p, so that an even chance of a doubled class is no longer a win."""
    network = create_model("ssdnet-lite")
    with torch.no_grad():
        network.semantic_head.bias.zero_()
        network.semantic_head.bias[1] = math.log(2.0)
    weights = torch.ones(network.config.num_classes)
    weights[1] = 2.0

    def released(share, weights=weights):
        release = Release(ReleaseRecipe(logit_adjustment=share), weights, {})
        return release_weights(network, release).state_dict()

    torch.testing.assert_close(released(1.0)[BIAS], torch.zeros(len(weights)))
    torch.testing.assert_close(released(0.5)[BIAS][1], torch.tensor(0.5 * math.log(2.0)))
    state = network.state_dict()
    assert torch.equal(released(1.0, None)[BIAS], state[BIAS])
    assert state[BIAS][1] == pytest.approx(math.log(2.0))
    changed = {name for name, value in released(1.0).items() if not torch.equal(value, state[name])}
    assert changed == {BIAS}


def test_offsets_are_added_to_the_logits_of_their_classes():
    network = create_model("ssdnet-lite")
    names = [info.name for info in network.config.classes]
    state = network.state_dict()
    release = ReleaseRecipe(logit_offsets=(("road", -0.5), ("pole", 1.0)))
    moved = release_weights(network, Release(release, None, {})).state_dict()[BIAS]
    steps = dict(zip(names, (moved - state[BIAS]).tolist(), strict=True))
    assert {name: step for name, step in steps.items() if step} == pytest.approx(
        {"road": -0.5, "pole": 1.0}
    )
    assert class_offsets(network, ()) is None


@pytest.mark.parametrize("offsets", [[("roads", 1.0)], [("road", 1.0), ("road", 2.0)]])
def test_offsets_of_what_is_no_class_or_named_twice_are_refused(offsets):
    text = r"release\.logit_offsets: 'roads?' .* its classes are sky, building"
    with pytest.raises(InputError, match=text):
        class_offsets(create_model("ssdnet-lite"), offsets)
