"""What weights a training starts from, and what it does to them before they ship."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from models import create_model, save_checkpoint
from models.efficientnet_lite import WIDTHS as EFFICIENTNET_WIDTHS
from models.efficientnet_lite import EfficientNetLite
from runtime.base.errors import CheckpointError, InputError
from runtime.recordings.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_frames
from training.run.network import ClassRecipe, ModelRecipe, build_network
from training.run.optimizer import train_parts
from training.scores.scoring import torch_predict
from training.weights.imagenet_weights import PACKAGE, load_imagenet
from training.weights.initial_weights import find_weights, read_weights
from training.weights.prune import prune_trunk


def test_classes_begin_with_the_rows_of_their_relatives(tmp_path, capsys):
    other = tmp_path / "other.pt"
    network = create_model("ssdnet-lite")
    heads = (network.semantic_head, network.semantic_coarse_head)
    with torch.no_grad():
        for head in heads:
            head.bias.copy_(torch.arange(11.0))
    save_checkpoint(other, network)
    own = {"walk": ("pavement", "road"), "lane": (), "truck": ("car",), "car": (), "SKY": ()}
    recipe = [ClassRecipe(name, (0, 0, 0), of) for name, of in own.items()]
    model = ModelRecipe("ssdnet-lite", classes=tuple(recipe))
    built = build_network(model, read_weights(other))
    assert built.config.class_rows == (2, 1, 1, 1, 1)
    for head in (built.semantic_head, built.semantic_coarse_head):
        rows = head.bias.tolist()
        assert rows[:2] + rows[5:] == [4, 3, 0]
        assert rows[3] != rows[4]
        assert rows[3:5] == pytest.approx([8, 8], abs=0.2)
        assert rows[2] == 0  # as it is initialised
    text = capsys.readouterr().err
    assert "begin at random: lane; name those that they join, as lane = road" in text
    assert "left out: building, pole, tree, sign, fence, pedestrian, bicyclist\n" in text
    # A further training, of classes that now have two rows.
    save_checkpoint(tmp_path / "walk.pt", built)
    further = [replace(info, of=()) for info in recipe[1:]]
    model = replace(model, classes=(ClassRecipe("path", (0, 0, 0), ("walk",)), *further))
    again = build_network(model, read_weights(tmp_path / "walk.pt"))
    assert again.config.class_rows == (2, 1, 1, 1, 1)
    assert torch.equal(again.semantic_head.weight, built.semantic_head.weight)
    guess = again.state_dict()["surface_depth.guess.weight"]
    assert torch.equal(guess, network.surface_depth.guess.weight)
    with pytest.raises(CheckpointError, match="none of its layers fits"):
        build_network(ModelRecipe("ssdnet-small"), read_weights(other))


def test_the_start_is_the_bundled_answer_joined():
    """Of five unions, with the weights that ship, on a frame of the bundled recording."""
    unions = ("road pavement", "building pole sign fence", "tree", "sky", "car pedestrian")
    classes = [ClassRecipe(f"own {n}", (0, 0, 0), tuple(u.split())) for n, u in enumerate(unions)]
    init = read_weights(find_weights("ssdnet-lite"))
    model = ModelRecipe("ssdnet-lite", tuple(classes), config={"canonical_focal_px": 721.5})
    frame = next(iter(bundled_frames()))
    inputs = frame.rgb, frame.sparse_depth, BUNDLED_FOCAL_LENGTH_PX
    before, start = (
        torch_predict(network)(*inputs) for network in (init.network, build_network(model, init))
    )
    names = [info.name for info in init.network.config.classes]
    joined = [next((n for n, u in enumerate(unions) if name in u), 9) for name in names]
    expected = np.array(joined)[before.semantic]
    known = expected < len(unions)  # without the bicyclists, who are left out
    assert known.mean() > 0.98
    assert (start.semantic == expected)[known].all()
    assert np.array_equal(start.depth, before.depth)


def test_init_reports_settings_that_change_what_weights_mean(tmp_path, capsys):
    other = tmp_path / "other.pt"
    save_checkpoint(other, create_model("ssdnet-lite"))
    build_network(ModelRecipe("ssdnet-lite"), read_weights(other))
    assert capsys.readouterr().err == ""
    build_network(ModelRecipe("ssdnet-lite", config={"max_depth_m": 80.0}), read_weights(other))
    assert "max_depth_m changed from 200.0 to 80.0" in capsys.readouterr().err


def test_frozen_layers_keep_weights_and_statistics_and_have_no_backward_pass():
    network = create_model("ssdnet-lite")
    early = ("encoder.stem", "encoder.stride2", "encoder.stride4")
    train_parts(network, (), early)
    before = {name: value.clone() for name, value in network.encoder.state_dict().items()}
    output = network(torch.rand(2, 3, 64, 64) * 255, torch.full((2, 1, 64, 64), 20.0))
    output.semantic_logits.sum().backward()
    moved = {
        name for name, value in network.encoder.state_dict().items() if value.ne(before[name]).any()
    }
    assert {name.split(".")[0] for name in moved} == {"stride8", "stride16", "stride32"}
    trained = {
        name.split(".")[0] for name, p in network.encoder.named_parameters() if p.grad is not None
    }
    assert trained == {"stride8", "stride16", "stride32"}
    at_2, at_4 = network.encoder.early(torch.rand(1, 3, 64, 64))
    assert not at_2.requires_grad
    assert not at_4.requires_grad
    with pytest.raises(InputError, match="no layer of 'ssdnet-lite' begins with"):
        train_parts(network, (), ("encoder.steam",))


def test_a_recipe_changes_fields_of_the_networks_configuration():
    config = {"decoder_channels": [8, 8, 8], "geometry_channels": 4}
    network = build_network(ModelRecipe("ssdnet-nano", config=config), None)
    expected = replace(create_model("ssdnet-nano").config, decoder_channels=(8, 8, 8))
    assert network.config == replace(expected, geometry_channels=4)
    alone = build_network(ModelRecipe("ssdnet-lite", config={"semantic_head": False}), None)
    assert "semantic" not in alone.heads
    assert alone.config.classes == ()


IMAGENET = ModelRecipe("ssdnet-lite", pretrained="imagenet", config={"encoder_widths": []})


def test_a_pretrained_encoder_is_loaded_with_its_normalisation():
    pytest.importorskip(PACKAGE.replace("-", "_"))
    network, trunk = build_network(IMAGENET, None), EfficientNetLite()
    load_imagenet(trunk)
    assert torch.equal(network.encoder.stem[0][0].weight, trunk.stem[0][0].weight)
    assert network.config.rgb_mean == (127.0,) * 3
    assert network.rgb_std.flatten().tolist() == [128.0] * 3
    resumed = build_network(IMAGENET, None, resumed=True)  # does not read them again
    assert not torch.equal(resumed.encoder.stem[0][0].weight, trunk.stem[0][0].weight)


def test_images_are_normalised_as_init_does_unless_the_recipe_says_otherwise(tmp_path):
    other = tmp_path / "other.pt"
    save_checkpoint(other, create_model("ssdnet-lite", rgb_mean=(1.0, 2.0, 3.0)))
    stated = ModelRecipe("ssdnet-lite", config={"rgb_mean": [4.0, 5.0, 6.0]})
    for recipe, mean in ((ModelRecipe("ssdnet-lite"), (1, 2, 3)), (stated, (4, 5, 6))):
        assert build_network(recipe, read_weights(other)).config.rgb_mean == mean


@pytest.mark.parametrize(("name", "config", "text"), [
    ("enet", {}, "'enet' has no encoder"), ("ssdnet-lite", {"rgb_mean": [9, 9, 9]}, "rgb_mean"),
])  # fmt: skip
def test_pretrained_weights_that_a_network_cannot_take_are_refused(name, config, text):
    with pytest.raises(InputError, match=text):
        build_network(ModelRecipe(name, pretrained="imagenet", config=config), None)


PICTURES = [torch.full((1, 3, 64, 96), 100.0)]
WIDTHS = (24, 48, *EFFICIENTNET_WIDTHS[2:])


def test_init_of_another_trunk_is_refused_until_it_is_pruned(tmp_path, capsys):
    wide = create_model("ssdnet-lite", encoder_widths=())
    save_checkpoint(tmp_path / "wide.pt", wide)
    narrow = ModelRecipe("ssdnet-lite", config={"encoder_widths": list(WIDTHS)})
    with pytest.raises(CheckpointError, match=r"wide\.pt: its trunk has other widths than .*24"):
        build_network(narrow, read_weights(tmp_path / "wide.pt"))
    pruned = prune_trunk(wide, WIDTHS, PICTURES)
    assert capsys.readouterr().err == "the trunk was pruned from 8960 to 8904 channels\n"
    save_checkpoint(tmp_path / "narrow.pt", pruned)
    network = build_network(narrow, read_weights(tmp_path / "narrow.pt"))
    assert capsys.readouterr().err == ""
    weight = network.encoder.stem[0][0].weight
    assert torch.equal(weight, pruned.encoder.stem[0][0].weight)
    with pytest.raises(CheckpointError, match="pruning only narrows a trunk"):
        prune_trunk(pruned, (), PICTURES)


def idle(block):
    """Nothing reads every second channel."""
    block.project[0].weight[:, ::2] = 0.0


def constant(block):
    """Every second channel says the same everywhere, which a bias can say, too."""
    block.depthwise[1].weight[::2] = 0.0
    block.depthwise[1].bias[::2] = 3.0


def repeated(block):
    """Every second channel says what the next one says, and is read differently."""
    for value in (*block.expand.parameters(), *block.depthwise.parameters()):
        value[::2] = value[1::2]


@pytest.mark.parametrize("spare", [idle, constant, repeated])
def test_pruning_takes_channels_that_others_make_up_for(spare, capsys):
    torch.manual_seed(0)
    wide = create_model("ssdnet-lite", encoder_widths=()).eval()
    trunk = wide.encoder
    with torch.no_grad():
        spare(trunk.stride4[0])
    widths = (EFFICIENTNET_WIDTHS[0], EFFICIENTNET_WIDTHS[1] // 2, *EFFICIENTNET_WIDTHS[2:])
    narrow = prune_trunk(wide, widths, [torch.rand(1, 3, 128, 160) * 255 for _ in range(3)])
    block, pruned = trunk.stride4[0], narrow.encoder.stride4[0]
    kept = [pruned.expand[0].weight, pruned.depthwise[0].weight, pruned.depthwise[1].bias]
    whole = [block.expand[0].weight, block.depthwise[0].weight, block.depthwise[1].bias]
    assert [len(each) for each in kept] == [48] * 3
    if spare is idle:
        assert all(torch.equal(one, all_[1::2]) for one, all_ in zip(kept, whole, strict=True))
    rgb = torch.rand(2, 3, 64, 96) * 2 - 1
    with torch.no_grad():
        found, expected = narrow.encoder.early(rgb), wide.encoder.early(rgb)
    assert torch.equal(found[0], expected[0])
    assert (found[1] - expected[1]).abs().max() < 0.1 * expected[1].std()


def test_pruning_leaves_a_fused_start_as_it_is():
    torch.manual_seed(0)
    widths = (16, 48, 48, *EFFICIENTNET_WIDTHS[3:])
    wide = create_model("ssdnet-lite", encoder_widths=widths, fused_start=True).eval()
    with torch.no_grad():
        idle(wide.encoder.stride8[0])
    narrow = prune_trunk(wide, (*widths[:3], widths[3] // 2, *widths[4:]), PICTURES)
    assert narrow.encoder.stride8[0].project[0].weight.shape[1] == widths[3] // 2
    rgb = torch.rand(1, 3, 64, 96) * 2 - 1
    with torch.no_grad():
        found, expected = (network.encoder.early(rgb) for network in (narrow, wide))
        assert all(map(torch.equal, found, expected))
        late = [network.encoder.late(found[1])[0] for network in (narrow, wide)]
    assert (late[0] - late[1]).abs().max() < 0.05 * late[1].std()
    with pytest.raises(InputError, match="no weights of ImageNet fit a fused start: give --init"):
        build_network(
            ModelRecipe(
                "ssdnet-lite",
                pretrained="imagenet",
                config={"encoder_widths": widths, "fused_start": True},
            ),
            None,
        )
