"""Checkpoints of version 1, where one class was both networks, become files of today."""

from dataclasses import replace

import pytest
import torch
from typer.testing import CliRunner

from models import SSDNetLiteConfig, create_model, load_checkpoint, save_checkpoint
from models.checkpoint_version_1 import convert_checkpoint
from models.registry import NETWORKS
from runtime.errors import CheckpointError, OutputError
from training.cli import app
from training.evaluation.cli import app as evaluate

#: What version 1 wrote beside today's fields.
PLAIN = {
    "encoder_block": "plain",
    "skip_fusion": "concat",
    "semantic_refine_channels": 0,
    "depth_surfaces": False,
    "depth_refine_channels": 0,
    "regressed_depth_m": None,
    "valid_mask_input": False,
    "global_context": False,
}
LITE = {
    "encoder_block": "residual",
    "skip_fusion": "add",
    "use_rgb": True,
    "use_sparse_depth": True,
    "valid_mask_input": True,
    "sparse_depth_gain": 1.0,
}
#: Today's names of layers of the lite network, and those of version 1.
NAMES = {
    "encoder.stem.": "stem.",
    "context.": "encoder.context.",
    "surface_depth.embed.": "surface_stem.",
    "surface_depth.project.": "surface_project.",
    "surface_depth.semantics.": "surface_semantics.",
    "surface_depth.refinement.": "depth_refine.",
    "surface_depth.head.": "surface_head.",
}


def small(name):
    entry = NETWORKS[name]
    widths = {
        key: (8,) * len(getattr(entry.config, key))
        for key in ("stem_channels", "encoder_channels", "decoder_channels")
    }
    if isinstance(entry.config, SSDNetLiteConfig):  # version 1 had no other encoder
        widths |= {"encoder": "residual", "encoder_widths": (), "additive_refinement": False}
    return entry.network(replace(entry.config, **widths)).eval()


def name_of_version_1(name):
    for now, before in NAMES.items():
        if name.startswith(now):
            return before + name.removeprefix(now)
    return name


def write_version_1(path, model, *, trainer=None, **changes):
    """The file that the release before wrote of a network."""
    save_checkpoint(path, model, training={"terms": "none"}, trainer=trainer)
    document = torch.load(path, weights_only=True)
    weights = document["weights"]
    if document["network"] == "SSDNetLite":
        del document["config"]["encoder"]
        document["config"] |= {**LITE, "depth_surfaces": document["config"]["depth_head"]}
        weights = {name_of_version_1(name): value for name, value in weights.items()}
    elif document["network"] == "SSDNet":
        document["config"] |= PLAIN
    if document["network"].startswith("SSDNet"):
        document["network"] = "SSDNet"
    document["config"] |= changes
    weights = {
        name: value.half() if value.is_floating_point() else value
        for name, value in weights.items()
    }
    torch.save({**document, "version": 1, "weights": weights}, path)
    return weights


@pytest.mark.parametrize(
    "name", ["ssdnet-lite", "ssdnet-nano", "ssdnet-small", "ssdnet-dep-rgb", "nconv"]
)
def test_it_keeps_every_bit_of_the_weights(tmp_path, name):
    model = create_model(name) if name == "nconv" else small(name)
    old, new = tmp_path / "old.pt", tmp_path / "new.pt"
    weights = write_version_1(old, model)
    result = CliRunner().invoke(app, ["--convert", str(old), str(new)])
    assert result.exit_code == 0, result.output
    converted = torch.load(new, weights_only=True)["weights"]
    assert {
        name_of_version_1(each) if "lite" in name or "nano" in name else each for each in converted
    } == weights.keys()
    for each, value in converted.items():
        before = weights[each] if each in weights else weights[name_of_version_1(each)]
        assert value.dtype == before.dtype
        assert torch.equal(value, before)
    loaded = load_checkpoint(new)
    assert type(loaded.model) is type(model)
    assert loaded.model.config == model.config
    assert loaded.training == {"terms": "none"}


def test_a_file_that_does_not_name_its_network_is_of_the_family(tmp_path):
    write_version_1(tmp_path / "old.pt", small("ssdnet-nano"))
    document = torch.load(tmp_path / "old.pt", weights_only=True)
    del document["network"]
    torch.save(document, tmp_path / "old.pt")
    convert_checkpoint(tmp_path / "old.pt", tmp_path / "new.pt")
    assert type(load_checkpoint(tmp_path / "new.pt").model).__name__ == "SSDNetLite"


def test_every_other_command_names_the_conversion(tmp_path):
    old = tmp_path / "old.pt"
    write_version_1(old, small("ssdnet-nano"))
    text = f"ssdnet-train --convert {old} NEW.pt"
    with pytest.raises(CheckpointError, match="version 1, of an earlier release") as caught:
        load_checkpoint(old)
    assert text in str(caught.value)
    result = CliRunner().invoke(evaluate, [str(old), "--data", f"camvid:{tmp_path}"])
    assert result.exit_code == 1
    assert "--convert" in result.output


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"depth_surfaces": False}, "values of depth_surfaces"),
        ({"encoder_block": "plain"}, "skip_fusion, "),
        ({"wings": 2}, "wings"),
        ({"sparse_depth_gain": torch.zeros(2)}, "values of sparse_depth_gain"),
    ],
)
def test_a_configuration_that_no_network_has_is_named(tmp_path, changes, text):
    write_version_1(tmp_path / "old.pt", small("ssdnet-nano"), **changes)
    with pytest.raises(CheckpointError, match=text):
        convert_checkpoint(tmp_path / "old.pt", tmp_path / "new.pt")
    assert not (tmp_path / "new.pt").exists()


def test_an_unfinished_run_is_refused(tmp_path):
    write_version_1(tmp_path / "last.pt", small("ssdnet-nano"), trainer={"step": 3})
    with pytest.raises(CheckpointError, match=r"unfinished run, .* Finish the run with that rele"):
        convert_checkpoint(tmp_path / "last.pt", tmp_path / "new.pt")


def test_only_version_1_is_converted_and_no_file_replaced(tmp_path):
    save_checkpoint(tmp_path / "new.pt", small("ssdnet-nano"))
    with pytest.raises(CheckpointError, match="version 2; only version 1 can be converted"):
        convert_checkpoint(tmp_path / "new.pt", tmp_path / "other.pt")
    with pytest.raises(OutputError, match=r"new\.pt exists"):
        convert_checkpoint(tmp_path / "new.pt", tmp_path / "new.pt")
