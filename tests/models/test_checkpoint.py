"""Checkpoints carry all that is needed and refuse all that is not theirs."""

import os
import resource
import zipfile
from dataclasses import replace

import pytest
import torch

from models import SSDNetLite, SSDNetLiteConfig, load_checkpoint, save_checkpoint
from models.checkpoint import Checkpoint
from models.classes import CAMVID_CLASSES, numbered_classes
from runtime.errors import CheckpointError

SMALL = SSDNetLiteConfig(
    encoder_widths=(8,) * 16,
    decoder_channels=(8, 8, 8),
    classes=CAMVID_CLASSES[:4],
    max_depth_m=77.0,
    rgb_mean=(1.0, 2.0, 3.0),
)


def test_round_trip_keeps_configuration_weights_and_answers(tmp_path):
    model = SSDNetLite(SMALL).eval()
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
    save_checkpoint(path, SSDNetLite(SMALL))
    data = path.read_bytes()
    path.write_bytes(data[: kept if kept > 1 else int(kept * len(data))])
    with pytest.raises(CheckpointError, match="truncated"):
        load_checkpoint(path)


@pytest.mark.parametrize("content", [b"\x89PNG\r\n", b"hello", b"\x08\n\x12\x07pytorch"])
def test_a_file_of_another_kind(tmp_path, content):
    path = tmp_path / "a.pt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="not an ssdnet checkpoint"):
        load_checkpoint(path)


def test_damaged_file(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"ssdnet-checkpoint", b"\xff" * 17, 1))
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(path)


def test_a_flipped_bit_of_a_weight_is_damage(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda entry: entry.file_size)
        values = archive.read(largest)
    content = bytearray(path.read_bytes())
    content[content.index(values) + len(values) // 2] ^= 1
    path.write_bytes(content)
    assert torch.load(path, weights_only=True)  # which takes any values
    with pytest.raises(CheckpointError, match=r"damaged .the checksum of 'archive/data/\d+' is"):
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
    with pytest.raises(CheckpointError, match="objects other than tensors") as caught:
        load_checkpoint(tmp_path / "c.pt")
    assert "weights_only" not in str(caught.value)  # torch's text tells how to run the code


def change(path, **changes):
    document = torch.load(path, weights_only=True)
    document.update(changes)
    torch.save(document, path)


def test_newer_version_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, version=3)
    with pytest.raises(CheckpointError, match="version 3"):
        load_checkpoint(path)


@pytest.mark.parametrize(
    "value", [torch.tensor([0, 0]), torch.tensor([1, 1]), [1], None, True, 1.0]
)
@pytest.mark.parametrize(("key", "message"), [("format", "no 'format"), ("version", "version")])
def test_a_format_or_version_of_another_type_is_refused(tmp_path, key, value, message):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, **{key: value})
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(path)


def test_unknown_configuration_key_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, config={**SMALL.to_dict(), "wings": 2})
    with pytest.raises(CheckpointError, match="wings"):
        load_checkpoint(path)


def test_weights_must_fit_the_configuration(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, config=replace(SMALL, classes=numbered_classes(6)).to_dict())
    with pytest.raises(CheckpointError, match="do not fit"):
        load_checkpoint(path)


def test_failed_write_keeps_the_old_file_and_leaves_no_other(tmp_path, mount_disk):
    save_checkpoint(tmp_path / "a.pt", SSDNetLite(SMALL))
    room_for_one = (tmp_path / "a.pt").stat().st_size * 3 // 2 // 1024
    path = mount_disk(room_for_one) / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL), training={"data": ["old"]})
    with pytest.raises(CheckpointError, match="could not be written"):
        save_checkpoint(path, SSDNetLite(SMALL))
    assert load_checkpoint(path).training["data"] == ["old"]
    assert [p.name for p in path.parent.iterdir()] == ["a.pt"]


def test_damaged_bytes_are_never_another_error(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
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
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, config={**SMALL.to_dict(), "geometry_channels": -4})
    with pytest.raises(CheckpointError, match="cannot be built here"):
        load_checkpoint(path)


def test_the_trained_height_is_a_valid_image_height():
    network = torch.nn.Identity()
    assert Checkpoint(network, {}).facts.trained_height is None
    assert Checkpoint(network, {"trained_height": None}).facts.trained_height is None
    assert Checkpoint(network, {"trained_height": 400}).facts.trained_height == 400
    for bad in (-5, 0, True, 400.0, "400", 10**9):
        with pytest.raises(CheckpointError, match="trained_height must be"):
            _ = Checkpoint(network, {"trained_height": bad}).facts.trained_height


def test_the_network_is_named(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    assert torch.load(path, weights_only=True)["network"] == "SSDNetLite"
    assert type(load_checkpoint(path).model) is SSDNetLite
    change(path, network="Unheard")
    with pytest.raises(
        CheckpointError, match="network 'Unheard', but this installation knows SSDN"
    ):
        load_checkpoint(path)


@pytest.fixture
def little_memory():
    """Whatever allocates gigabytes fails."""
    with open("/proc/self/statm") as statm:
        used = int(statm.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"encoder_widths": (10**9, *[8] * 15)}, "encoder_widths: expected 1 to 8192, got 1000000"),
        ({"encoder_widths": (8192,) * 16}, "has the shape"),
        ({"encoder_widths": (8,) * 1000}, "expected 16 positive widths"),
        ({"decoder_channels": (8, 8, 16)}, "it lacks the tensors depth_decoder"),
        ({"decoder_channels": (8, 0, 8)}, "decoder_channels: expected 1 to 8192, got 0"),
        ({"geometry_channels": 10**9}, "geometry_channels: expected 1 to"),
        ({"decoder_channels": (8.0, 8, 8)}, "wrong type: 8.0"),
        ({"decoder_channels": "888"}, "decoder_channels has the wrong type"),
        ({"depth_head": 1}, "depth_head has the wrong type: 1"),
        ({"max_depth_m": 1e39}, "max_depth_m must be"),
        ({"max_depth_m": "77"}, "max_depth_m has the wrong type"),
        ({"classes": ({"name": "road", "color": (1, 2)},) * 4}, "color has the wrong type"),
        ({"rgb_std": (0.0, 1.0, 1.0)}, "rgb_std must be positive"),
    ],
)
def test_oversized_configurations_are_refused_before_they_are_built(
    tmp_path, changes, message, little_memory
):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    change(path, config={**SMALL.to_dict(), **changes})
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(path)


def weights_of(path, convert):
    document = torch.load(path, weights_only=True)
    weights = document["weights"]
    document["weights"] = {name: convert(name, value) for name, value in weights.items()}
    torch.save(document, path)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_floating_point_weights_of_any_precision_load(tmp_path, dtype):
    path = tmp_path / "a.pt"
    model = SSDNetLite(SMALL)
    save_checkpoint(path, model)
    weights_of(path, lambda _, value: value.to(dtype) if value.is_floating_point() else value)
    weight = load_checkpoint(path).model.encoder.stem[0][0].weight
    assert weight.dtype == torch.float32
    torch.testing.assert_close(weight, model.encoder.stem[0][0].weight, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize("dtype", [torch.int64, torch.uint8, torch.bool, torch.complex64])
def test_weights_of_another_type_are_not_cast(tmp_path, dtype):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    weights_of(
        path, lambda name, value: value.to(dtype) if name == "encoder.stem.0.0.weight" else value
    )
    with pytest.raises(CheckpointError, match=r"encoder\.stem\.0\.0\.weight is of type torch\."):
        load_checkpoint(path)


def test_tensors_that_repeat_one_value_are_refused(tmp_path, little_memory):
    """A small file that asks for gigabytes of weights."""
    huge = replace(SMALL, encoder_widths=(8192,) * 16, decoder_channels=(8192,) * 3)
    with torch.device("meta"):
        shapes = {name: value.shape for name, value in SSDNetLite(huge).state_dict().items()}
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    counters = {name for name in shapes if name.endswith("num_batches_tracked")}
    weights = {
        name: torch.zeros((), dtype=torch.int64 if name in counters else torch.float32).expand(
            shape
        )
        for name, shape in shapes.items()
    }
    change(path, config=huge.to_dict(), weights=weights)
    assert path.stat().st_size < 300_000
    with pytest.raises(CheckpointError, match="larger than the data stored"):
        load_checkpoint(path)


def test_a_file_that_unpacks_to_much_more_is_refused(tmp_path, little_memory):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data/bomb", bytes(2**26))
    with pytest.raises(CheckpointError, match="it would unpack from"):
        load_checkpoint(path)


def test_a_file_that_allocates_memory_is_a_checkpoint_error(tmp_path, little_memory):
    """PyTorch's reader allows bytearray(n) and torch.FloatTensor(n)."""
    for kind in (b"cbuiltins\nbytearray\n", b"ctorch\nFloatTensor\n"):
        with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
            call = kind + b"\x8a\x05\x00\x00\x00\x00\x02\x85R."  # kind(2**33)
            archive.writestr("a/data.pkl", b"\x80\x02" + call)
            archive.writestr("a/version", b"3\n")
        with pytest.raises(CheckpointError, match="damaged"):
            load_checkpoint(tmp_path / "a.pt")


def test_a_file_larger_than_any_checkpoint_is_not_read(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, SSDNetLite(SMALL))
    whole = path.read_bytes()
    with path.open("wb") as stream:  # sparse: takes no space
        stream.write(whole[:4])
        stream.seek(9 * 2**30)
        stream.write(whole)
    with pytest.raises(CheckpointError, match="at most 8589934592"):
        load_checkpoint(path)
