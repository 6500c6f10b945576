"""Checkpoints carry all that is needed and refuse all that is not theirs."""

import os
from dataclasses import replace

import pytest
import torch

from models import SSDNet, load_checkpoint, save_checkpoint
from models.checkpoint import Checkpoint
from models.classes import CAMVID_CLASSES, numbered_classes
from models.registry import NETWORKS
from runtime.errors import CheckpointError

SMALL = replace(
    NETWORKS["ssdnet-lite"].config,
    encoder_channels=(8, 8, 8, 8),
    encoder_blocks=(1, 1, 1, 1),
    decoder_channels=(8, 8, 8),
    stem_channels=(8, 8),
    classes=CAMVID_CLASSES[:4],
    max_depth_m=77.0,
    rgb_mean=(1.0, 2.0, 3.0),
)


def test_round_trip_keeps_configuration_weights_and_answers(tmp_path):
    model = SSDNet(SMALL).eval()
    save_checkpoint(tmp_path / "a.pt", model, training={"data": ["x"]}, trainer={"step": 3})
    loaded = load_checkpoint(tmp_path / "a.pt")
    assert loaded.model.config == SMALL
    assert not loaded.model.training
    assert loaded.training["data"] == ["x"]
    assert loaded.trainer["step"] == 3
    rgb, depth = torch.rand(1, 3, 40, 50) * 255, torch.rand(1, 1, 40, 50) * 50
    with torch.no_grad():
        assert torch.equal(loaded.model(rgb, depth).depths[0], model(rgb, depth).depths[0])


def test_missing_file(tmp_path):
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        load_checkpoint(tmp_path / "none.pt")


@pytest.mark.parametrize("kept", [0, 10, 0.5, 0.98])
def test_truncated_file(tmp_path, kept):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    data = path.read_bytes()
    path.write_bytes(data[: kept if kept > 1 else int(kept * len(data))])
    with pytest.raises(CheckpointError, match="truncated"):
        load_checkpoint(path)


@pytest.mark.parametrize("content", [b"\x89PNG\r\n", b"hello", b"\x08\n\x12\x07pytorch"])
def test_a_file_of_another_kind(tmp_path, content):
    path = tmp_path / "a.pt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="of another kind"):
        load_checkpoint(path)


def test_damaged_file(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"ssdnet-checkpoint", b"\xff" * 17, 1))
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(path)


def test_foreign_pytorch_file(tmp_path):
    torch.save({"state_dict": {"a": torch.zeros(2)}}, tmp_path / "b.pt")
    with pytest.raises(CheckpointError, match="not an ssdnet checkpoint"):
        load_checkpoint(tmp_path / "b.pt")


class Evil:
    """Would run code if it were unpickled."""

    def __reduce__(self):
        return os.system, ("true",)


def test_a_file_that_wants_to_run_code_is_refused(tmp_path):
    torch.save({"format": "ssdnet-checkpoint", "x": Evil()}, tmp_path / "c.pt")
    with pytest.raises(CheckpointError, match="something else than tensors") as caught:
        load_checkpoint(tmp_path / "c.pt")
    assert "weights_only" not in str(caught.value)  # torch's text tells how to run the code


def change(path, **changes):
    document = torch.load(path, weights_only=True)
    document.update(changes)
    torch.save(document, path)


def test_newer_version_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    change(path, version=2)
    with pytest.raises(CheckpointError, match="version 2"):
        load_checkpoint(path)


def test_unknown_configuration_key_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    change(path, config={**SMALL.to_dict(), "wings": 2})
    with pytest.raises(CheckpointError, match="wings"):
        load_checkpoint(path)


def test_weights_must_fit_the_configuration(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    change(path, config=replace(SMALL, classes=numbered_classes(6)).to_dict())
    with pytest.raises(CheckpointError, match="do not fit"):
        load_checkpoint(path)


def test_failed_write_keeps_the_old_file_and_leaves_no_other(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL), training={"data": ["old"]})

    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(CheckpointError, match="No space left"):
        save_checkpoint(path, SSDNet(SMALL))
    monkeypatch.undo()
    assert load_checkpoint(path).training["data"] == ["old"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


def test_damaged_bytes_are_never_another_error(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    whole = path.read_bytes()
    draw = torch.Generator().manual_seed(0)
    refused = 0
    for position in torch.randint(0, 4000, (60,), generator=draw).tolist():
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            load_checkpoint(path)
        except CheckpointError:
            refused += 1
    assert refused


def test_configuration_that_cannot_be_built_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNet(SMALL))
    change(path, config={**SMALL.to_dict(), "boundary_channels": -4})
    with pytest.raises(CheckpointError, match="cannot be built here"):
        load_checkpoint(path)


def test_the_trained_height_is_one_that_pictures_have():
    network = torch.nn.Identity()
    assert Checkpoint(network, {}).trained_height is None
    assert Checkpoint(network, {"trained_height": None}).trained_height is None
    assert Checkpoint(network, {"trained_height": 400}).trained_height == 400
    for bad in (-5, 0, True, 400.0, "400", 10**9):
        with pytest.raises(CheckpointError, match="trained_height must be"):
            _ = Checkpoint(network, {"trained_height": bad}).trained_height
