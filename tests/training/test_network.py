"""What weights a training starts from, and what it does to them before they ship."""

import math
from dataclasses import replace

import pytest
import torch

from models import CLASS_TABLES, SSDNetLiteConfig, create_model, load_checkpoint, save_checkpoint
from runtime.errors import InputError
from training.network import adjust_logits, build_network, class_offsets, train_parts
from training.recipe import ModelRecipe


def test_logit_adjustment_undoes_the_class_weights():
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


def test_offsets_are_added_to_the_logits_of_their_classes():
    network = create_model("ssdnet-lite")
    names = [info.name for info in network.config.classes]
    state = network.state_dict()
    offsets = class_offsets(network, [("road", -0.5), ("pole", 1.0)])
    moved = adjust_logits(state, None, 0.0, offsets)["semantic_head.bias"]
    steps = dict(zip(names, (moved - state["semantic_head.bias"]).tolist(), strict=True))
    assert {name: step for name, step in steps.items() if step} == pytest.approx(
        {"road": -0.5, "pole": 1.0}
    )
    assert class_offsets(network, ()) is None


@pytest.mark.parametrize("offsets", [[("roads", 1.0)], [("road", 1.0), ("road", 2.0)]])
def test_offsets_of_what_is_no_class_or_named_twice_are_refused(offsets):
    with pytest.raises(InputError, match=r"loop\.logit_offsets: 'roads?' .* it has sky, building"):
        class_offsets(create_model("ssdnet-lite"), offsets)


def test_init_does_not_take_one_class_for_another(tmp_path, capsys):
    network = create_model("ssdnet-lite", classes=tuple(reversed(CLASS_TABLES["camvid"])))
    other = tmp_path / "other.pt"
    with torch.no_grad():
        network.semantic_head.bias.fill_(77.0)
    save_checkpoint(other, network)
    built = build_network(ModelRecipe("ssdnet-lite"), other)
    assert "with random weights: semantic_head\n" in capsys.readouterr().err
    assert not (built.semantic_head.bias == 77.0).any()
    assert torch.equal(built.state_dict()["depth_heads.0.weight"], network.depth_heads[0].weight)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"max_depth_m": 80.0}, "the depth range [m] was 200.0 and is 80.0 here"),
        ({"boundary_gating": False}, "the gating by boundaries was True and is False here"),
    ],
)
def test_init_reports_settings_that_change_what_weights_mean(tmp_path, capsys, changed, text):
    other = tmp_path / "other.pt"
    save_checkpoint(other, create_model("ssdnet-lite"))
    build_network(ModelRecipe("ssdnet-lite"), other)
    assert capsys.readouterr().err == ""
    build_network(ModelRecipe("ssdnet-lite", **changed), other)
    assert text in capsys.readouterr().err


def test_only_some_parts_are_trained():
    network = create_model("ssdnet-lite")
    train_parts(network, ("depth_", "surface_"))
    trained = {name.split(".")[0] for name, p in network.named_parameters() if p.requires_grad}
    assert trained == {"depth_decoder", "depth_heads", "surface_depth"}
    assert not network.encoder.training
    assert network.depth_decoder.training
    train_parts(network, ())
    assert all(p.requires_grad for p in network.parameters())
    assert all(module.training for module in network.modules())
    with pytest.raises(InputError, match=r"begins with 'deep'; it has encoder, .*depth_decoder"):
        train_parts(network, ("depth_", "deep"))


def test_canonical_focal_length_goes_from_the_recipe_into_the_checkpoint(tmp_path):
    recipe = ModelRecipe("ssdnet-lite", canonical_focal_px=721.5)
    network = build_network(recipe, None)
    assert network.config.canonical_focal_px == 721.5
    save_checkpoint(tmp_path / "a.pt", network)
    assert load_checkpoint(tmp_path / "a.pt").model.config == network.config
    plain = build_network(ModelRecipe("nconv"), None)
    assert plain.config.canonical_focal_px is None
    save_checkpoint(tmp_path / "b.pt", plain)
    assert load_checkpoint(tmp_path / "b.pt").model.config == plain.config


@pytest.mark.parametrize("focal", [0, -1.0, float("nan"), float("inf"), "721", True])
def test_a_network_refuses_a_focal_length_that_no_camera_has(focal):
    config = {**create_model("ssdnet-lite").config.to_dict(), "canonical_focal_px": focal}
    with pytest.raises(ValueError, match="canonical_focal_px"):
        SSDNetLiteConfig.from_dict(config)


def test_a_recipe_changes_fields_of_the_networks_configuration():
    config = {"encoder_blocks": [1, 1, 1, 1], "boundary_channels": 4, "global_context": False}
    network = build_network(ModelRecipe("ssdnet-lite", config=config), None)
    expected = replace(create_model("ssdnet-lite").config, encoder_blocks=(1, 1, 1, 1))
    assert network.config == replace(expected, boundary_channels=4, global_context=False)
    alone = build_network(
        ModelRecipe("ssdnet-lite", config={"semantic_head": False}),
        None,
    )
    assert "semantic" not in alone.heads
    assert alone.config.classes == ()


@pytest.mark.parametrize(
    ("name", "config", "text"),
    [
        ("ssdnet-lite", {"global_context": [1]}, "global_context has the wrong type"),
        ("ssdnet-lite", {"boundary_channels": "8"}, "boundary_channels has the wrong type"),
        (
            "ssdnet-lite",
            {"layers": 3},
            "no configuration field of the network 'ssdnet-lite': layers",
        ),
        ("ssdnet-lite", {"encoder_blocks": [1]}, "must have the same length"),
        (
            "fast-scnn",
            {"boundary_channels": 8},
            "field of the network 'fast-scnn': boundary_channels",
        ),
    ],
)
def test_an_invalid_configuration_is_refused(name, config, text):
    with pytest.raises(InputError, match=text):
        build_network(ModelRecipe(name, config=config), None)
