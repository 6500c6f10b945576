"""Checks of a checkpoint file before anything of its size is allocated."""

import pickletools
import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

#: Ten times the largest network of the registry with its optimiser's state.
MAX_BYTES = 8 * 2**30
_ZIP_START = b"PK\x03\x04"
_PICKLE = "data.pkl"
#: Globals in pickles of tensors and plain values; others could call, and allocate, anything.
_KNOWN_GLOBALS = frozenset(
    {"collections OrderedDict", "torch._utils _rebuild_tensor_v2"}
    | {
        f"torch {kind}Storage"
        for kind in ("Float", "Double", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte")
    }
    | {f"torch {kind}Storage" for kind in ("Bool", "ComplexFloat", "ComplexDouble")}
)


def check_archive(path: Path) -> None:
    """Raise ValueError unless the file is a zip archive as torch.save writes it.

    It must be whole, unpack to no more than its own size (torch.save does not compress), and hold
    only tensors and plain values. A damaged file may also raise any error of zipfile and
    pickletools, an unreadable one OSError.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(len(_ZIP_START))
    if not _ZIP_START.startswith(start):
        raise ValueError("not an ssdnet checkpoint. Give a file that ssdnet-train wrote.")
    if not zipfile.is_zipfile(path):  # its directory comes last
        raise ValueError(f"truncated ({size} bytes). Copy it again.")
    if size > MAX_BYTES:
        raise ValueError(f"{size} bytes; a checkpoint has at most {MAX_BYTES}.")
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > size:
            raise ValueError(
                f"it would unpack from {size} to {unpacked} bytes; a checkpoint is "
                "stored uncompressed. Give a file that ssdnet-train wrote."
            )
        for entry in entries:
            if entry.filename.endswith(_PICKLE):
                _check_pickle(archive.read(entry))


def check_weights(weights: Mapping[str, object], expected: Mapping[str, Tensor]) -> None:
    """Raise ValueError unless the weights fit ``expected``, a network's state on any device.

    Names and shapes must be the same; floating-point values may have any precision, others must
    have the same type. Every tensor must hold its own values: an expanded one would grow when
    copied.
    """
    missing = sorted(expected.keys() - weights.keys())
    unknown = sorted(map(str, weights.keys() - expected.keys()))
    for problem, names in (("lacks the tensors", missing), ("has the unknown tensors", unknown)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise ValueError(f"it {problem} {', '.join(names[:3])}{more}")
    held: dict[int, int] = {}
    wanted = 0
    for name, value in expected.items():
        weight = weights[name]
        if not isinstance(weight, Tensor) or weight.layout != torch.strided:
            raise ValueError(f"{name} is not a dense tensor")
        if weight.shape != value.shape:
            raise ValueError(
                f"{name} has the shape {tuple(weight.shape)}, expected {tuple(value.shape)}"
            )
        if weight.dtype != value.dtype and not (
            weight.is_floating_point() and value.is_floating_point()
        ):
            raise ValueError(f"{name} is of type {weight.dtype}, expected {value.dtype}")
        storage = weight.untyped_storage()
        held[storage.data_ptr()] = storage.nbytes()
        wanted += weight.numel() * weight.element_size()
    if sum(held.values()) < wanted:
        raise ValueError("some of its tensors are larger than the data stored for them")


def _check_pickle(content: bytes) -> None:
    for opcode, argument, _ in pickletools.genops(content):
        foreign = opcode.name == "GLOBAL" and argument not in _KNOWN_GLOBALS
        if foreign or opcode.name in ("STACK_GLOBAL", "INST"):
            # The message does not say how to load it anyway.
            raise ValueError(
                "it contains objects other than tensors and plain values, which could run code "
                "when loaded. Give a file that ssdnet-train wrote."
            )
