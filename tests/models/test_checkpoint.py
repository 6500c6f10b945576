"""Checkpoints carry all that is needed and refuse all that is not theirs."""

import os
import re
import shutil
import zipfile
from pathlib import Path

import pytest
import torch

from models import SSDNetLite, SSDNetLiteConfig, load_checkpoint, save_checkpoint
from models.checkpoint import Checkpoint, run_folder
from models.classes import CAMVID_CLASSES, numbered_classes
from runtime.base.errors import CheckpointError

SMALL = SSDNetLiteConfig(
    encoder_widths=(8,) * 16,
    decoder_channels=(8, 8, 8),
    classes=CAMVID_CLASSES[:4],
    max_depth_m=77.0,
    rgb_mean=(1.0, 2.0, 3.0),
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A checkpoint of a network of SMALL; tests that change it copy it."""
    path = tmp_path_factory.mktemp("checkpoint") / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    return path


@pytest.fixture
def path(written, tmp_path):
    return Path(shutil.copy(written, tmp_path))


def change(path, **changes):
    torch.save(torch.load(path, weights_only=True) | changes, path)


def change_weights(path, convert):
    weights = torch.load(path, weights_only=True)["weights"]
    change(path, weights={name: convert(name, value) for name, value in weights.items()})


def refused(path, message):
    """Return the error of a file that is refused: what is wrong, a colon, and what to do."""
    with pytest.raises(CheckpointError, match=message) as caught:
        load_checkpoint(path)
    assert re.search(r": [a-z].*[^.]$", str(caught.value))
    return str(caught.value)


def test_round_trip_keeps_configuration_weights_and_answers(tmp_path):
    model = SSDNetLite(SMALL).eval()
    save_checkpoint(tmp_path / "a.pt", model, training={"data": ["x"]}, trainer={"step": 3})
    loaded = load_checkpoint(tmp_path / "a.pt")
    assert loaded.model.config == SMALL
    assert not loaded.model.training
    assert (loaded.training, loaded.trainer) == ({"data": ["x"]}, {"step": 3})
    rgb, depth = torch.rand(1, 3, 40, 50) * 255, torch.rand(1, 1, 40, 50) * 50
    with torch.no_grad():
        assert torch.equal(loaded.model(rgb, depth).depths[0], model(rgb, depth).depths[0])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda data: data[:0], "truncated"),
        (lambda data: data[:10], "truncated"),
        (lambda data: data[: len(data) // 2], "truncated"),
        (lambda data: data[:-9], "truncated"),
        (lambda data: b"\x89PNG\r\n", "not an ssdnet checkpoint"),
        (lambda data: data.replace(b"ssdnet-checkpoint", b"\xff" * 17, 1), "damaged"),
    ],
)
def test_a_damaged_file_is_named_as_such(path, spoil, message):
    path.write_bytes(spoil(path.read_bytes()))
    refused(path, message)


def test_a_flipped_bit_of_a_weight_is_damage(path):
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda entry: entry.file_size)
        values = archive.read(largest)
    content = bytearray(path.read_bytes())
    content[content.index(values) + len(values) // 2] ^= 1
    path.write_bytes(content)
    assert torch.load(path, weights_only=True)  # which takes any values
    refused(path, r"damaged .the checksum of 'archive/data/\d+' is")


def test_damaged_bytes_are_never_another_error(path):
    whole = path.read_bytes()
    refused = 0
    draw = torch.Generator().manual_seed(0)
    for position in torch.randint(0, 4000, (60,), generator=draw).tolist():
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            load_checkpoint(path)
        except CheckpointError:
            refused += 1
    assert refused


class Evil:
    """Would run code if it were unpickled."""

    def __reduce__(self):
        return os.system, ("true",)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (None, "no such checkpoint"),
        ({"state_dict": {"a": torch.zeros(2)}}, "not an ssdnet checkpoint"),
        ({"format": "ssdnet-checkpoint", "x": Evil()}, "objects other than tensors"),
        ({"format": "ssdnet-checkpoint", "config": {}}, "lacks weights"),
    ],
)
def test_what_is_no_checkpoint_is_refused_and_runs_no_code(tmp_path, document, message):
    if document is not None:
        torch.save(document, tmp_path / "a.pt")
    # PyTorch's text, which mentions weights_only, explains how to run the code.
    assert "weights_only" not in refused(tmp_path / "a.pt", message)


def test_failed_write_keeps_the_old_file_and_leaves_no_other(path, mount_disk):
    target = mount_disk(path.stat().st_size * 3 // 2 // 1024) / "a.pt"  # room for one
    save_checkpoint(target, SSDNetLite(SMALL), training={"data": ["old"]})
    with pytest.raises(CheckpointError, match="could not be written"):
        save_checkpoint(target, SSDNetLite(SMALL))
    assert load_checkpoint(target).training["data"] == ["old"]
    assert list(target.parent.iterdir()) == [target]


def test_a_checkpoint_belongs_to_a_run_by_its_name_and_the_recipe_beside_it(tmp_path):
    assert run_folder(tmp_path / "model.pt") is None
    (tmp_path / "recipe.json").touch()
    assert run_folder(tmp_path / "ssdnet-lite.pt") is None
    for name in ("model.pt", "best.pt", "last.pt"):
        assert run_folder(tmp_path / name) == tmp_path


def test_the_trained_height_is_a_valid_image_height():
    network = torch.nn.Identity()
    assert Checkpoint(network, {"trained_height": 400}).facts.trained_height == 400
    with pytest.raises(CheckpointError, match="trained_height must be"):
        _ = Checkpoint(network, {"trained_height": -5}).facts


def test_a_network_is_found_by_its_registered_name_and_in_old_files_by_its_class(path):
    before = load_checkpoint(path).model.state_dict()
    for written, now in (("ssdnet-lite", "SSDNetLite"), ("SSDNetLite", "ssdnet-lite")):
        assert torch.load(path, weights_only=True)["network"] == written
        change(path, network=now)
        after = load_checkpoint(path).model.state_dict()
        assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_a_network_that_could_not_be_read_is_not_written(tmp_path):
    class Unregistered(SSDNetLite):
        pass

    with pytest.raises(CheckpointError, match=r"Unregistered of the network .* is not registered"):
        save_checkpoint(tmp_path / "a.pt", Unregistered(SMALL))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 3}, "version 3"),
        ({"network": "Unheard"}, "not installed: unknown model 'Unheard'; known: ssdnet"),
    ],
)
def test_what_another_release_wrote_is_named(path, changes, message):
    change(path, **changes)
    refused(path, message)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wings": 2}, "wings"),
        ({"classes": [vars(info) for info in numbered_classes(6)]}, "do not fit"),
        ({"encoder_widths": (10**9, *[8] * 15)}, "encoder_widths: expected 1 to 8192, got 1000000"),
        ({"encoder_widths": (8192,) * 16}, "has the shape"),  # nothing of that size is allocated
        ({"decoder_channels": (8, 8, 16)}, "it lacks the tensors depth_decoder"),
        ({"geometry_channels": -4}, "cannot be built here .geometry_channels: expected 1 to"),
        ({"decoder_channels": (8.0, 8, 8)}, "wrong type: 8.0"),
        ({"decoder_channels": "888"}, "decoder_channels has the wrong type"),
        ({"depth_head": 1}, "depth_head has the wrong type: 1"),
        ({"max_depth_m": "77"}, "max_depth_m has the wrong type"),
        ({"classes": ({"name": "road", "color": (1, 2)},) * 4}, "color has the wrong type"),
        ({"rgb_std": (0.0, 1.0, 1.0)}, "rgb_std must be positive"),
    ],
)
def test_a_configuration_that_cannot_be_built_or_has_other_weights_is_named(path, changes, message):
    change(path, config=SMALL.to_dict() | changes)
    refused(path, message)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64])
def test_floating_point_weights_of_any_precision_load(path, dtype):
    expected = load_checkpoint(path).model.encoder.stem[0][0].weight
    change_weights(path, lambda _, each: each.to(dtype) if each.is_floating_point() else each)
    weight = load_checkpoint(path).model.encoder.stem[0][0].weight
    assert weight.dtype == torch.float32
    torch.testing.assert_close(weight, expected, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize(
    ("value", "message"), [(torch.zeros(8, 3, 3, 3).long(), "of type torch.int64"), ([], "tensor")]
)
def test_weights_of_another_type_are_not_cast(path, value, message):
    name = "encoder.stem.0.0.weight"
    change_weights(path, lambda key, each: value if key == name else each)
    refused(path, f"{name} is .*{message}")


def test_old_weights_of_unknown_names_are_counted(path):
    weights = torch.load(path, weights_only=True)["weights"]
    change(path, weights=weights | {f"old{number}": torch.zeros(1) for number in range(5)})
    refused(path, "unknown tensors old0, old1, old2 and 2 more")
