"""What weights a training starts from, and what it does to them before they ship."""

from dataclasses import replace

import pytest
import torch

from models import CLASS_TABLES, SSDNetLiteConfig, create_model, load_checkpoint, save_checkpoint
from runtime.errors import InputError
from training.network import build_network, train_parts
from training.recipe import ModelRecipe


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
    build_network(ModelRecipe("ssdnet-lite", config=changed), other)
    assert text in capsys.readouterr().err


def test_images_are_normalised_as_init_does_unless_the_recipe_says_otherwise(tmp_path, capsys):
    other = tmp_path / "other.pt"
    save_checkpoint(other, create_model("ssdnet-lite", rgb_mean=(1.0, 2.0, 3.0)))
    built = build_network(ModelRecipe("ssdnet-lite"), other)
    assert built.config.rgb_mean == (1.0, 2.0, 3.0)
    assert built.rgb_mean.flatten().tolist() == [1.0, 2.0, 3.0]
    assert capsys.readouterr().err == ""
    stated = ModelRecipe("ssdnet-lite", config={"rgb_mean": [4.0, 5.0, 6.0]})
    built = build_network(stated, other)
    assert built.config.rgb_mean == (4.0, 5.0, 6.0)
    assert built.rgb_mean.flatten().tolist() == [4.0, 5.0, 6.0]
    text = "the mean of RGB was (1.0, 2.0, 3.0) and is (4.0, 5.0, 6.0) here"
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
    recipe = ModelRecipe("ssdnet-lite", config={"canonical_focal_px": 721.5})
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
        ("ssdnet-lite", {"max_depth_m": -1.0}, "max_depth_m"),
        ("ssdnet-lite", {"max_depth_m": 1e39}, "max_depth_m"),
        *(
            ("ssdnet-lite", {"canonical_focal_px": focal}, "canonical_focal_px")
            for focal in (0, 0.5, -700.0, float("inf"), float("nan"), "721", 2e6)
        ),
        ("fast-scnn", {"boundary_channels": 8}, "unknown model configuration keys"),
    ],
)
def test_an_invalid_configuration_is_refused(name, config, text):
    with pytest.raises(InputError, match=text):
        build_network(ModelRecipe(name, config=config), None)
