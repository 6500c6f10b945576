"""Every shipped recipe trains: one step of a shrunk network on small files of its data sets."""

import math
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from layouts import camvid, cityscapes, kitti_depth, kitti_stream, kitti_streets, virtual_kitti
from layouts.pictures import write
from models import (
    CLASS_TABLES,
    SSDNetConfig,
    SSDNetLiteConfig,
    create_model,
    load_checkpoint,
    save_checkpoint,
)
from models.registry import NETWORKS, Entry
from training.losses.terms import TERMS
from training.recipes.chosen_recipe import read_stages
from training.recipes.pandaset_street import CAMERAS
from training.recipes.registry import RECIPES
from training.run.loop import train
from training.run.network import build_network
from training.run.training_run import TrainingRun
from training.weights.initial_weights import read_weights

# What sets of these kinds can be scored on; all others on everything.
CLASSES, DEPTH = {"miou", "boundary_f"}, {"mae_m", "rmse_m"}
SCORES = {"camvid": CLASSES, "kitti-depth": DEPTH, "kitti-streets": DEPTH}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """All data sets that recipes name, where they name them, in frames of some 40 x 70 pixels."""
    root = tmp_path_factory.mktemp("data")
    label = np.arange(12, dtype=np.uint8).repeat(6)[None].repeat(40, axis=0)
    for split in ("train", "val"):
        rgb = np.full((*label.shape, 3), (90, 120, 200), np.uint8)
        camvid.write_frame(root / "camvid", rgb, label, split=split)
        cityscapes.write_frame(root / "cityscapes", split=split, magnify=6)
        cityscapes.write_stereo(root / "cityscapes", split=split, magnify=6)
    kitti_depth.write_drive(root / "kitti_depth", magnify=8)
    kitti_depth.write_selection(root / "kitti_depth", magnify=8)
    # The recipes validate on frames 50 to 59.
    kitti_stream.write_stream(root / "kitti_stream", frames=52, labelled=52, magnify=5)
    kitti_stream.write_stream(root / "kitti_drive_0009", frames=2, labelled=2, magnify=5)
    kitti_streets.write_streets(root / "kitti_streets", (2, 69, 70, 98), magnify=5, road=True)
    kitti_stream.write_objects(root / "kitti_object")
    for path, folders in (
        ("kitti_labelled", ("image_02", "semantic")),
        ("nuscenes_boston", ("image", "pseudo_semantic")),
        *((f"pandaset_street/{camera}", ("image", "label")) for camera in CAMERAS),
    ):
        # About as large as those whose intrinsics the recipes state.
        down, right, ignored = (9, 17, 11) if path == "kitti_labelled" else (11, 11, 255)
        ids = np.where(label == 11, ignored, label).repeat(down, axis=0).repeat(right, axis=1)
        write(root / path / folders[0] / "a.png", np.full((*ids.shape, 3), 90, np.uint8))
        write(root / path / folders[1] / "a.png", ids)
        write(root / path / "lidar" / "a.png", np.full(ids.shape, 2560, np.uint16))
    for path in (
        "train",
        "rendered/train",
        "rendered/kitti",
        "rendered/varied",
        "rendered/open_val",
    ):
        variant = virtual_kitti.write_second_edition(root / path, magnify=5)
        virtual_kitti.write_scans(variant)
    # The paper validates on the end of its last scene.
    for scene, numbers in (("0002", (0, 1)), ("0020", (547,))):
        virtual_kitti.write_first_edition(root / "vkitti", scene, numbers=numbers, magnify=5)
    return root


@pytest.fixture(autouse=True)
def shrunk_networks(request, monkeypatch):
    """Networks keep their stages, inputs and heads, with one block of few channels a stage.

    Only recipes of several stages load ImageNet's weights, which fit the whole encoder.
    """
    whole = len(RECIPES[request.node.callspec.params["name"]].stages) > 1
    if not whole:
        monkeypatch.setattr("training.run.network.pretrain", lambda network, *_, **__: network)
    for name, (network, config) in NETWORKS.items():
        if isinstance(config, SSDNetConfig):
            encoder = {
                "stem_channels": (8,) * len(config.stem_channels),
                "encoder_channels": (8,) * len(config.encoder_channels),
                "encoder_blocks": (1,) * len(config.encoder_blocks),
                "boundary_channels": 4,
            }
        elif isinstance(config, SSDNetLiteConfig):
            encoder = {} if whole else {"encoder_widths": (8,) * 16}
        else:
            continue
        shrunk = replace(config, **encoder, decoder_channels=(8,) * len(config.decoder_channels))
        monkeypatch.setitem(NETWORKS, name, Entry(network, shrunk))


def shrink(size):
    """A small size that leaves the same remainder on the networks' coarsest grid, 32 pixels."""
    return 32 + size[0] % 32, 64 + size[1] % 32


def shrink_sources(sources):
    """Make sources small and equally frequent, so that the batch holds a frame of each."""
    return tuple(
        replace(item, weight=1.0, size=None if item.size is None else shrink(item.size))
        for item in sources
    )


def read_shrunk(name):
    """The stages of a recipe, each for one step on small frames.

    All that they say about network and loss stays.
    """
    changes = (
        *("data.batch_size = 16", "data.seed = 26", "data.workers = 0", "schedule.steps = 1"),
        "schedule.warmup_steps = 0",
        *("validation.every = 1", "loop.log_every = 1"),
    )
    return [
        replace(stage, recipe=shrink_recipe(stage.recipe)) for stage in read_stages(name, changes)
    ]


def shrink_recipe(recipe):
    height, width = shrink(recipe.data.augment.crop)
    if recipe.data.augment.pair_shift:  # the views need room within their borders
        height, width = height + 96, width + 64
    crop = replace(recipe.data.augment, crop=(height, width))
    sources, validation = map(shrink_sources, (recipe.data.source, recipe.validation.source))
    return replace(
        recipe,
        data=replace(recipe.data, augment=crop, source=sources),
        validation=replace(recipe.validation, source=validation),
    )


def expected_terms(loss, config):
    """Terms that a recipe gives a weight and that its network has the heads for."""
    terms = {name for name in TERMS if loss.weight(name)}
    if not config.semantic_head:
        terms -= {"semantic", "semantic_iou", "lovasz", "semantic_boundary", "semantic_depth"}
    if not config.depth_head:
        terms -= {"depth", "semantic_depth"}
    if not isinstance(config, SSDNetLiteConfig):
        terms -= {"depth_uncertainty"}
    return terms


def read_scalars(folder):
    """What TensorBoard shows: {group: {name: value}}."""
    events = EventAccumulator(str(folder))
    events.Reload()
    groups = {"loss": {}, "validation": {}}
    for tag in events.Tags()["scalars"]:
        group, _, name = tag.partition("/")
        groups.setdefault(group, {})[name] = events.Scalars(tag)[-1].value
    return groups


#: The last stages of others, and `ablation-ssdnet` with other weights of two terms.
LIKE_OTHERS = (
    "lite-depth",
    "nano-depth",
    "open-depth",
    "ablation-joint-weights-1",
    "ablation-ssdnet-ind",
)


@pytest.mark.parametrize(
    "name",
    [
        # Several stages take up to 30 seconds.
        pytest.param(name, marks=[pytest.mark.slow] if len(recipe.stages) > 1 else [])
        for name, recipe in RECIPES.items()
        if name not in LIKE_OTHERS
    ],
)
def test_shipped_recipe_trains(name, data, tmp_path):
    init = None
    if name in ("lite-classes", "open"):  # frozen layers begin with trained weights
        network = create_model("ssdnet-lite", **RECIPES[name].stages[0].recipe.model.config)
        save_checkpoint(tmp_path / "init.pt", network, training={"data": ["ImageNet"]})
        init = read_weights(tmp_path / "init.pt")
    for stage in read_shrunk(name):
        trained = check_training(stage.recipe, data, tmp_path / stage.folder, init)
        init = finish(stage, trained, init)


def finish(stage, trained, init):
    """Return what the next stage begins with."""
    if stage.then is None:
        return read_weights(trained)
    after = load_checkpoint(trained)
    pictures = [torch.full((1, 3, 64, 96), 100.0)]
    network = stage.then(after.model, pictures)
    assert all(value.isfinite().all() for value in network.state_dict().values())
    result = trained.with_name("result.pt")
    save_checkpoint(result, network, training=after.training)
    return read_weights(result)


def check_training(recipe, data, out, init):
    """Train a step; the checkpoint has all that the recipe says. Returns its path."""
    torch.manual_seed(recipe.data.seed)
    picture = torch.full((1, 3, 64, 96), 100.0)
    start = build_network(recipe.model, init, pictures=[picture]).state_dict()
    teacher = None
    if recipe.loss.taught_heads(("semantic", "depth", "boundary")):
        path = out.with_suffix(".pt")
        save_checkpoint(path, create_model("ssdnet-lite", **recipe.model.config))
        teacher = read_weights(path)
    trained = train(recipe, TrainingRun([data], out, init=init, teacher=teacher)).path
    checkpoint = load_checkpoint(trained)

    config = checkpoint.model.config
    assert config.name == recipe.model.name
    assert config.classes == (CLASS_TABLES[recipe.model.classes] if config.semantic_head else ())
    assert checkpoint.training["recipe"]["loss"] == asdict(recipe.loss)
    assert recipe.terms
    assert checkpoint.facts.terms.startswith(recipe.terms)

    weights = checkpoint.model.state_dict()
    assert all(value.isfinite().all() for value in weights.values())
    still = {
        name
        for name, value in checkpoint.model.named_parameters()
        if value.ndim > 1 and torch.equal(value, start[name])
    }
    # Heads of coarser scales that no loss looks at.
    coarse = {name for name in start if re.fullmatch(r"depth_heads\.[1-9]\.weight", name)}
    idle = coarse if recipe.loss.depth_scales == "finest" else set()
    named = {name for name, value in checkpoint.model.named_parameters() if value.ndim > 1}
    frozen = {name for name in named if name.startswith(recipe.optimizer.frozen)}
    assert still == idle | frozen

    shown = read_scalars(out / "tensorboard")
    terms = expected_terms(recipe.loss, config)
    assert shown["loss"].keys() == terms | {"total"}
    shown["loss"].pop("depth_uncertainty", None)  # the log of a density
    assert all(0 < value < math.inf for value in shown["loss"].values())
    assert shown["validation"].keys() == {
        f"{item.title}/{score}"
        for item in recipe.validation.source
        for score in SCORES.get(item.kind, CLASSES | DEPTH)
    }
    assert all(math.isfinite(value) for value in shown["validation"].values())
    return trained
